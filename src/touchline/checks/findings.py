"""What `touchline check` found: how bad, where, what, and what to do about it."""

from dataclasses import dataclass

from touchline.enums import StrEnum


class Severity(StrEnum):
    """How much a finding matters. An error will spoil the localization, a warning may."""

    OK = "ok"
    NOTE = "note"
    WARNING = "warning"
    ERROR = "error"


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding. check: the name of the check that made it. where: a file, with line or frames if that helps.

    what: what was measured, in a sentence. advice: what to do; empty if there is nothing to do. code: one of
    `ProblemCode`, where one says what is wrong; else empty.
    """

    check: str
    severity: Severity
    where: str
    what: str
    advice: str = ""
    code: str = ""

    def __str__(self) -> str:
        return f"{self.where}: {self.what}. {self.advice}"


def graded(check: str, where: str, what: str, *cases: tuple[bool, Severity, str], code: str = "") -> Finding:
    """The finding by the first case that holds: condition, severity, advice. Where none does, all is well. code: of a
    finding that is not.
    """
    for holds, severity, advice in cases:
        if holds:
            return Finding(check, severity, where, what, advice, code)
    return Finding(check, Severity.OK, where, what)


def too_few(check: str, where: str, purpose: str, looked: int, needed: int) -> Finding:
    """That too few images can be used to tell anything."""
    what = f"too few images to tell {purpose}: {looked} usable, {needed} are needed"
    return Finding(check, Severity.NOTE, where, what, "Record more images, or mend what is wrong with these.")
