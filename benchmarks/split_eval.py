"""dev harness (replaced below)"""
