"""Everything that draws: moderngl stays in here."""
