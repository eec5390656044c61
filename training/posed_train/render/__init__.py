"""Training images: random static scenes of known meshes among clutter, under random lights, seen by several cameras.

`layout` draws a scene, an engine shows it, `dataset` writes what the engine shows as a BOP-format folder with exact
poses, boxes and masks of the visible part, and visible fractions. Two engines: `rasteriser` (MuJoCo, tens of
milliseconds an image) for the thousands of crops that training needs, and `cycles` (Blender, seconds an image), whose
light is right, for validation and for the share of training that keeps the other half honest.
"""
