"""Solvers of the built problem: Levenberg-Marquardt on the block band, a box, IPOPT."""
