"""Where light goes: lenses, poses, and flat surfaces that bend it. Numbers and arrays only, in mm."""
