"""iris-fusion (Ismail et al. 2021)."""
