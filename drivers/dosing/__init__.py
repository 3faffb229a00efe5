"""The doser: all that it promises and refuses, whichever pump is behind it.

`PumpDoser` implements `tankrig.devices.Doser`; a driver adds a `Pump`: how its device is asked, set off and stopped.
"""
