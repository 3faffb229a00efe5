"""An archive of runs: listed, compared, opened as one dataset, fitted anew, and made of other people's frames."""
