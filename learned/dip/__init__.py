"""Deep Inertial Poser (Huang et al. 2018): six sensors at 60 Hz."""
