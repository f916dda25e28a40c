"""`touchline calibrate mirror`: the model-free calibration of section 3.2 of Lu et al. 2013."""

import math

from touchline.calibration.calibrated import Calibrated
from touchline.camera.model_free import SUPPORT
from touchline.camera.writing import camera_yaml
from touchline.published.nubot_mcl.mirror_picture import mirror_picture
from touchline.published.strip.mirror import MirrorCalibration, calibrate_mirror
from touchline.sources import Recording


def calibrated_mirror(recording: Recording, skip_unusable: bool = False, support: int = SUPPORT) -> Calibrated:
    """Ranges and bearings for every direction, as `calibrate_mirror` finds them. Raises its InputErrors."""
    found = calibrate_mirror(recording, skip_unusable, support)
    sighting = found.sightings[0]
    image = recording.image(sighting.index)
    assert image is not None  # it was read a moment ago
    words = _words(found, recording.name)
    return Calibrated(camera_yaml(found.camera, words), mirror_picture(found, image, sighting), words, found.unusable)


def _words(calibration: MirrorCalibration, name: str) -> str:
    camera, edges = calibration.camera, calibration.strip.edges_m
    hidden = f"\n{calibration.filled} edges, hidden or spoilt, were taken from the other directions."
    hidden = hidden if calibration.filled else ""
    return (
        f"Mirror calibrated without a model from {name}: {len(calibration.sightings)} images of {len(edges)} edges.\n"
        f"Centre {camera.center[0]:.2f}, {camera.center[1]:.2f} px; "
        f"{'mirrored' if camera.handedness < 0 else 'straight'} image; "
        f"mounted at {math.degrees(camera.mount_yaw_rad):.2f}°; "
        f"bearings agree to {math.degrees(calibration.bearing_error_rad):.2f}°.\n"
        f"Known from edges between {edges[0]:g} and {edges[-1]:g} m; continued from {camera.range_m[:, 0].min():.2f} "
        f"to {camera.range_m[:, -1].max():.1f} m.{hidden}"
    )
