"""Models prepared once for a geometry and a pattern, that answer for any medium in a millisecond."""
