"""Which of ROS 2's networks is meant."""

from __future__ import annotations

import os

from touchline.errors import InputError


def domain_id() -> int:
    """ROS_DOMAIN_ID, else 0. Raises InputError."""
    text = os.environ.get("ROS_DOMAIN_ID", "").strip() or "0"
    if not text.isdigit() or int(text) > 232:
        raise InputError(f"ROS_DOMAIN_ID={text:.40}: expected a number from 0 to 232")
    return int(text)
