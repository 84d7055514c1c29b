"""Case files: a case in TOML, checked whole, built, and written back; and the commands that work on them."""
