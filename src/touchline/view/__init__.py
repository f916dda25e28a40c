"""Pictures of what was seen and where that puts the robot."""

from touchline.view.birds_eye import birds_eye_image
from touchline.view.overlay import overlay_image, projected_lines
from touchline.view.stages import contact_sheet, save_pictures

__all__ = ["birds_eye_image", "contact_sheet", "overlay_image", "projected_lines", "save_pictures"]
