"""How a person uses tankrig: the command line and the window."""
