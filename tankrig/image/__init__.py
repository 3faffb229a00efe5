"""From light to what a camera delivers, and back from files: predictions, observations, pictures of both."""
