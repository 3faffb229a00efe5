"""The rig's own ink doser: its driver, and an emulator that speaks its protocol on a pseudo-terminal.

The protocol is firmware_notes/rig_doser.md. Driver and emulator are written from that page and share no code.
"""
