"""A New Era NE-1000 as far as its serial line shows it.

Written from firmware_notes/new_era.md; shares no code with the driver.
"""
