"""What may be wrong with sensors: one file a check, findings out."""
