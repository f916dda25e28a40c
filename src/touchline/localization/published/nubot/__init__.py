"""Parts of nubot-mti and nubot-mcl (Xiong et al.; Lu et al. 2013)."""
