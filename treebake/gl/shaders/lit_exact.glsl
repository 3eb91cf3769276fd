// Draws as lit.glsl does, but cuts MASK out as if the leaf were modelled, not as a client with mipmaps does.
#define EXACT_CUTOUTS
#include "lit.glsl"
