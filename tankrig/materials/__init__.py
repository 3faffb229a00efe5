"""Reference liquids: what is published of them, how much to dose, and whether a run agrees."""
