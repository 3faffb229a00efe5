"""The finite tank."""
