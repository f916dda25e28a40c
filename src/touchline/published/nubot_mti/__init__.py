"""nubot-mti (Xiong et al.)."""
