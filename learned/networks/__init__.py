"""The architectures: DIP's and IMUPoser's, and the DIP paper's rows for its tables."""
