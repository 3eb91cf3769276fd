// Draws as leaf_triangles.glsl does, onto pixels of 4 samples.
#define FOUR_SAMPLES
#include "leaf_triangles.glsl"
