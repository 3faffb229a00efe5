"""A Cavro XCalibur as far as its serial line shows it.

Written from firmware_notes/cavro.md; shares no code with the driver.
"""
