"""Known materials, and materials from laboratory measurements."""
