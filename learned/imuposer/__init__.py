"""IMUPoser (Mollyn et al. 2023): one to three of five everyday devices at 25 Hz."""
