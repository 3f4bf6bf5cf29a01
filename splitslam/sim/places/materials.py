"""Reflectivity of what places are made of, 0 .. 255 as a VLP-16 tells it at short range."""

GRASS, PAVING, ASPHALT, STONE, PLASTER, BRICK, CONCRETE = 45, 22, 14, 60, 75, 40, 50
WOOD, METAL, LEAVES, ROOF, SIGN, RUBBER, CLOTH = 35, 55, 50, 18, 220, 6, 30
GLASS = 8  # the one number that also says what happens to a beam: see `Perturbations.glass`
