"""Stages of a remeshing with sharp interfaces: functions from a `Remeshing` to the next one."""
