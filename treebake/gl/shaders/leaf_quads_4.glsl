// Draws as leaf_quads.glsl does, onto pixels of 4 samples.
#define FOUR_SAMPLES
#include "leaf_quads.glsl"
