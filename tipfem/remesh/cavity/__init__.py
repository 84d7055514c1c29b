"""Cavities: changes of meshes of simplices in rounds, the same in two and three dimensions."""
