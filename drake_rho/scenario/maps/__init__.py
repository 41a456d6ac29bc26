"""Maps of the real world: unions of very many cells or triangles, as obstacles.

`Voxels` holds cubes, from an OctoMap, a grid or a point cloud, and `Mesh` triangles. Each has
`parts`, the cubes or triangles themselves, against which plans are verified, and a `cover`, a union
of convex parts of which planners keep clear. A tree of boxes (`box_tree`) finds the parts near a
motion, so that work grows with what is near and not with the map.
"""
