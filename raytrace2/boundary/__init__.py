"""Where images jump: silhouettes, creases and shadow edges, and how the image changes when they move.

Derivatives inside surfaces and shadows leave out that their edges move. What that brings is an integral along the edges
of the jump times the motion across the edge, which is estimated by sampling points of them (Li, Aittala, Durand and
Lehtinen, "Differentiable Monte Carlo ray tracing through edge sampling", SIGGRAPH Asia 2018). Edges are those of
meshes, rims of rectangles, disks and cylinders and the outlines of spheres and cylinders. What hides an edge hides both
sides, and both sides of the jump are rendered with the same random numbers, a step apart that rounding needs.

An edge moves relative to the samples that find it, and each technique has edges of its own, which jump by the weight
that multiple importance sampling gives it:

- Edges on the film (:mod:`.silhouettes`): of all light, where the camera sees that surfaces end.
- Edges of shadows, of light found by sampling lights, for one point or direction of a light at a time: on the film
  (:mod:`.shadow_edges`), and as surfaces see them that scatter that light on (:mod:`.scattered_shadows`). They move as
  the point does for fixed random numbers: with its light, and on spheres, which are sampled by how they are seen, with
  the surface that is lit.
- Edges in the directions that a surface gathers light from (:mod:`.gathered_edges`): of all light found by sampling
  materials, emitted and scattered. Where edges are asked for, derivatives inside hold such directions fixed in the
  world when surfaces turn, so that these edges move just as they are seen from the moving surface.

Together these are all of the derivative, for any smooth material, of light that is scattered no more than six times; of
light scattered more often, what edges bring after that is left out.

Not seen are: edges in mirrors and through glass, and shadows behind masks (a warning says so where there are such); the
lines in which surfaces run through each other, those where spot lights and textures end, shadow terminators of smooth
normals on coarse meshes, and the near plane. Edges that only partly lie on one another are each counted in full.
Vertices at one place are taken to move together. Instances are refused. Holding directions makes derivatives by what
turns shiny surfaces noisier, the more the less rough they are.
"""
