"""A LightCrafter 4500 as far as its USB side shows it, for the real pyusb.

Written from TI's programmer's guide (DLPU010) and TI's own source; shares no code with the driver.
"""
