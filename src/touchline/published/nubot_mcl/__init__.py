"""nubot-mcl (Lu et al. 2013)."""
