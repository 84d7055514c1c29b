"""The packages of tipfem: render/ and demos/ stand beside tipfem/ in the tree, and are imported as parts of it."""

from setuptools import find_packages, setup

FOLDERS = {"tipfem": "tipfem", "tipfem.render": "render", "tipfem.demos": "demos"}
BELOW = [f"{package}.{name}" for package, folder in FOLDERS.items() for name in find_packages(folder)]

setup(package_dir=FOLDERS, packages=[*FOLDERS, *BELOW])
