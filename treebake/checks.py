"""Whether settings are in range, told in one way."""

from collections.abc import Iterable

from treebake.errors import SettingsError


def check(table: str, settings: object, rules: Iterable[tuple[str, bool, str]]) -> None:
    """Raise SettingsError for the first rule that does not hold: (a setting's name, whether it holds, what it must be).

    table: of the settings, for the message.
    """
    for name, valid, hint in rules:
        if not valid:
            raise SettingsError(f"[{table}] {name} is {getattr(settings, name)}; it must be {hint}")


def is_power_of_two(value: int, least: int, most: int) -> bool:
    """Whether a value is a power of two within a range."""
    return least <= value <= most and value & (value - 1) == 0
