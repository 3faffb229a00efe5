"""What the pumps' stand-ins have in common: cable, faults, and the truth about what was delivered.

Knows no protocol; shares no code with the drivers.
"""
