"""Where images jump: silhouettes, creases and shadow edges, and how the image changes when they move.

Derivatives inside surfaces and shadows leave out that their edges move. What that brings is an integral along the edges
on the film, of the jump times the motion across the edge, which is estimated by sampling points of them (Li, Aittala,
Durand and Lehtinen, "Differentiable Monte Carlo ray tracing through edge sampling", SIGGRAPH Asia 2018). Edges are
those of meshes, rims of rectangles, disks and cylinders and the outlines of spheres and cylinders, as the camera sees
them, and the edges of the shadows that these cast, from points of lights, on what the camera sees directly. Both sides
of the jump are rendered with the same random numbers, a step apart that rounding needs; what hides an edge hides both
sides.

Not seen are: edges in mirrors and through glass, shadows in light that was scattered before, the lines in which
surfaces run through each other, those where spot lights and textures end, shadow terminators of smooth normals on
coarse meshes, and the near plane. Edges that only partly lie on one another are each counted in full. Vertices at one
place are taken to move together. Instances are refused.

Edges of shadows follow points of lights. Where materials are sampled for light as well (the path tracer; direct light
with ``bsdf_samples``), that part of the light has edges that move otherwise when the surface or the light does: the
derivative is then exact where the surfaces that receive shadows and the lights stand still, and else off in proportion
to what the material's samples count for, which is little for small lights and much for a sky; a warning says so. It is
exact for point, spot and directional
lights, and for ``Integrator(kind="direct", emitter_samples=1, bsdf_samples=0)``.
"""
