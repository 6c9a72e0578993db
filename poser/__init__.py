"""The application: command line, built-in motion, tables and pictures."""
