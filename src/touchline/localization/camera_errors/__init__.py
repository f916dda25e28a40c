"""What a built camera differs by from its camera.yaml."""
