"""Rigid solids, meshes, fields and voxels, as worlds."""
