"""Metadata that depends on where the project lives: its addresses, and the README with whole links.

On the package index a relative link leads nowhere and a relative picture does not show.
"""

import re
from pathlib import Path

from hatchling.metadata.plugin.interface import MetadataHookInterface

ADDRESS = "https://touchline.example/touchline"  # the repository; whoever publishes sets theirs, here alone
_RELATIVE_LINK = re.compile(r"\]\((?!https?:|#)([^)\s]+)\)")
_PICTURES = (".jpg", ".png", ".svg")


class Addresses(MetadataHookInterface):
    PLUGIN_NAME = "custom"

    def update(self, metadata: dict) -> None:
        readme = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {"content-type": "text/markdown", "text": with_whole_links(readme)}
        metadata["urls"] = {
            "Homepage": ADDRESS,
            "Documentation": f"{ADDRESS}/blob/main/docs/architecture.md",
            "Changelog": f"{ADDRESS}/blob/main/CHANGELOG.md",
            "Issues": f"{ADDRESS}/issues",
        }


def with_whole_links(text: str) -> str:
    """Markdown whose links into the repository are addresses: pictures as they are, anything else as its page."""

    def whole(link: re.Match[str]) -> str:
        view = "raw" if link[1].endswith(_PICTURES) else "blob"
        return f"]({ADDRESS}/{view}/main/{link[1]})"

    return _RELATIVE_LINK.sub(whole, text)
