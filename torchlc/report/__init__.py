"""Pages and words for people."""
