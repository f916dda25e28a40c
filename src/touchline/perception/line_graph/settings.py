"""Settings of the line graph detector. Lengths on the ground are in metres, in the image in pixels."""

from typing import Literal

from pydantic import Field

from touchline.config import Settings, added


class LineGraphPaper(Settings):
    """Switches to the paper's exact form; each turns off an addition of ours."""

    colours: Literal["relative", "yuv"] = added(
        "relative",
        paper="yuv",
        description="yuv as in the paper: a luminance threshold for white, an ellipse in U, V for green; relative: "
        "white against the carpet about it, green as rays from black",
    )
    plain_boundary: bool = added(
        False,
        paper=True,
        description="true as in the paper: columns are scanned from the image's lower edge, and end where the three "
        "thresholds end; false: the robot's own body is passed over, the end is trimmed to the last carpet and to the "
        "carpet's straight edges",
    )
    fixed_low_pass: bool = added(
        False,
        paper=True,
        description="true: one low-pass everywhere; false: wider where the field's lines are wide in the image",
    )
    strays: bool = added(
        True,
        paper=False,
        description="a cell that is hardly white after the low-pass is no skeleton; false: only one without any white",
    )
    corner_split: bool = added(
        True,
        paper=False,
        description="a component whose own end lies farthest from its line is split at its corner; false: it loses "
        "that end",
    )
    circles_in_image: bool = added(
        True,
        paper=False,
        description="crossings are verified by circles on the ground in the whole image; false: by a circle and white "
        "ways in the colour cells",
    )
    subpixel: bool = added(
        True,
        paper=False,
        description="lines are placed by profiles across them in the whole image; false: by the cells' nodes alone",
    )
    circle: bool = added(
        True,
        paper=False,
        description="the centre circle is looked for: a landmark, and its arcs are no lines",
    )
    meetings: bool = added(
        True,
        paper=False,
        description="crossings are looked for where lines meet, too; false: at key nodes only",
    )
    paths: bool = added(
        True,
        paper=False,
        description="where no circle gets round, as beside a post, a T is told by white paths alone; false: never",
    )
    white_marks: bool = added(
        True,
        paper=False,
        description="white goal posts and penalty marks are looked for; false: coloured posts and poles alone",
    )


class LineGraphSettings(Settings):
    """Detection of lines, crossings and landmarks by the line structure graph."""

    colour_file: str | None = Field(
        None,
        description="a colour table written by touchline calibrate colour, kept for the whole run; none: colours are "
        "learned from the first images, and again when the green fades",
    )
    learning_frames: int = Field(5, ge=1, le=1_000, description="first images that the colours are learned from")
    max_range_m: float = Field(8.0, gt=0, description="ground beyond this range is not looked at (m)")
    pixel_threshold: float = Field(0.3, ge=0, le=1, description="t_pix: field colour of a cell, as a share")
    row_threshold: float = Field(0.6, ge=0, le=1, description="t_row: mean field colour of two rows of cells")
    window_threshold: float = Field(0.45, ge=0, le=1, description="t_win: mean field colour of the window below a cell")
    split_px: float = Field(4.0, gt=0, description="distance from its line from which on a component is split (px)")
    min_line_m: float = Field(0.15, ge=0, description="shorter lines are ignored (m)")
    min_line_px: float = Field(30.0, ge=0, description="lines shorter in the image are ignored: short and far (px)")
    crossing_m: float = Field(5.0, gt=0, description="crossings farther away are not looked for (m)")
    noise_px: float = Field(0.7, gt=0, description="standard deviation of a place in the image (px)")
    noise_m: float = Field(0.01, ge=0, description="standard deviation of the ground itself (m)")
    paper: LineGraphPaper = LineGraphPaper()
