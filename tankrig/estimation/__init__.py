"""From images to scattering coefficients with error bars."""
