"""The cost, one file a term. A term knows its residual and Jacobian; `base` assembles them."""
