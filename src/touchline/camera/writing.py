"""The text of a camera.yaml."""

from touchline.camera.omni import OmniCamera


def camera_yaml(camera: OmniCamera, remark: str) -> str:
    """camera.yaml of a calibrated camera, with a remark (lines) at its top."""
    lines = [f"# {line}".rstrip() for line in remark.splitlines()]
    sure = camera.stated_uncertainty
    words = "" if sure is None else ", ".join(f"{key}: {value:g}" for key, value in sure.mapping().items())
    lines += [
        "model: omni",
        f"width: {camera.width}",
        f"height: {camera.height}",
        f"center: [{camera.center[0]:.3f}, {camera.center[1]:.3f}]",
        f"inner_radius_px: {camera.inner_radius_px:.1f}",
        f"outer_radius_px: {camera.outer_radius_px:.1f}",
        f"handedness: {camera.handedness}",
        f"mount_yaw: {camera.mount_yaw_rad:.6f}",
        *([f"uncertainty: {{{words}}}"] if words else []),
        "range_table:",
        f"  radius_px: [{', '.join(f'{r:g}' for r in camera.radius_px)}]",
        f"  bearing_rad: [{', '.join(f'{b:.6f}' for b in camera.bearings_rad)}]",
        "  range_m:",
    ]
    lines += [f"  - [{', '.join(f'{r:.5f}' for r in row)}]" for row in camera.range_m]
    if camera.bearing_offset_rad is not None:
        lines.append("  bearing_offset_rad:")
        lines += [f"  - [{', '.join(f'{b:.6f}' for b in row)}]" for row in camera.bearing_offset_rad]
    return "\n".join(lines) + "\n"
