"""Stands in for Taichi: hands on to the fork that TI_FORK names, for a run on it with this folder in PYTHONPATH."""

import importlib
import importlib.abc
import importlib.util
import os
import sys

FORK = os.environ["TI_FORK"]


class Parts(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds the parts of the fork by Taichi's names."""

    def find_spec(self, name, path, target=None):
        """A part that the fork has, too."""
        return importlib.util.spec_from_loader(name, self) if name.startswith("taichi.") else None

    def create_module(self, spec):
        """The fork's."""
        return importlib.import_module(FORK + spec.name.removeprefix("taichi"))

    def exec_module(self, module):
        """It has run already."""


class Runtime:
    """What `taichi.lang.impl.pytaichi` is in Taichi."""

    @property
    def prog(self):
        """Taichi's program."""
        return impl.get_runtime()._prog

    def __getattr__(self, name):
        return getattr(impl.get_runtime(), name)


sys.meta_path.insert(0, Parts())
sys.modules["taichi"] = importlib.import_module(FORK)
impl = importlib.import_module(f"{FORK}.lang.impl")
if not hasattr(impl, "pytaichi"):
    impl.pytaichi = Runtime()
names = importlib.import_module(f"{FORK}.lang.ast.ast_transformer_utils")
if not hasattr(names, "ASTTransformerContext"):
    names.ASTTransformerContext = type("ASTTransformerContext", (), {})
kernel_impl = importlib.import_module(f"{FORK}.lang.kernel_impl")
if not hasattr(kernel_impl, "_get_tree_and_ctx"):  # a method there, which asks for what tipfem puts in its place
    base = importlib.import_module(f"{FORK}.lang._func_base").FuncBase
    kernel_impl._get_tree_and_ctx = base.get_tree_and_ctx
    base.get_tree_and_ctx = lambda self, *given, **options: kernel_impl._get_tree_and_ctx(self, *given, **options)
    base.arguments = property(lambda self: self.arg_metas)
