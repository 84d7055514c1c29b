"""The command line: the commands that check, run, resume and look."""
