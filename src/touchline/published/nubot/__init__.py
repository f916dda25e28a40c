"""What nubot-mti and nubot-mcl share: matching to the distance map, failure detection, Kalman fusion."""
