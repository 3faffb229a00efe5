"""A liquid that was measured, in the files of other programs."""
