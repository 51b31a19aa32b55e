"""Errors a user can mend. Every message says what was expected, what was found, and the remedy."""

from __future__ import annotations


class TwoHandsError(Exception):
    """Base of every expected failure. The command line prints it as one line and exits with code 2."""


class InputError(TwoHandsError):
    """A value, file or folder given by the user cannot be used."""


class DataFormatError(TwoHandsError):
    """A file exists but does not hold what its format promises."""


class CheckpointError(TwoHandsError):
    """Weights are missing, damaged, or belong to another network."""


class MissingExtraError(TwoHandsError):
    """An optional part of the package is needed but not installed.

    Args:
        feature: what was asked for, in the user's words.
        extra: the name of the pip extra that brings it.
    """

    def __init__(self, feature: str, extra: str) -> None:
        super().__init__(
            f"{feature} needs the extra '{extra}': pip install 'twohands[{extra}]', or '.[{extra}]' in a checkout"
        )
        self.feature, self.extra = feature, extra

    def __reduce__(self) -> tuple[type[MissingExtraError], tuple[str, str]]:
        """Pickled by its arguments: worker processes hand their errors over."""
        return type(self), (self.feature, self.extra)


class RendererError(TwoHandsError):
    """Nothing can be rendered on this machine."""


class PlausibilityWarning(UserWarning):
    """What was given can be computed with, but is hard to believe; the message names the likely mistake."""
