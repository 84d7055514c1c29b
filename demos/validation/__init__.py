"""Validation: runs that are compared with experiments, closed forms and other codes, one folder a benchmark."""
