"""A Cavro XCalibur or XLP as far as its serial line shows it.

Written from the manuals and firmware_notes/cavro.md; shares no code with the driver.
"""
