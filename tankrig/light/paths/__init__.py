"""Light paths on lattices: how they begin, fly, scatter, are seen by the camera, and are recorded."""
