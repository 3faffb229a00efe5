"""Every device, real and simulated, and the emulators that stand in for real ones in tests."""
