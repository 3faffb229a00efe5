"""The rig's own doser, real in every way but the motor: firmware, memory, motor and cable in a process of its own.

Written from firmware_notes/rig_doser.md; shares no code with the driver.
"""
