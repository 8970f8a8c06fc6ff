"""Where the object, the observer and the Sun are, and how the object is turned."""
