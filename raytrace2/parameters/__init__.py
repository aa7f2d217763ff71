"""Values of a scene that may change after it was loaded: their names, their present values, and what changes with
them."""
