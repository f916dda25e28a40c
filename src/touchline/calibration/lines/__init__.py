"""A mirror camera calibrated from the field's own lines, with no camera.yaml to begin with."""
