// Counts the fragments that leaves on cards of their own ask to be shaded.
#include "leaf_quads_corners.glsl"

#ifdef FRAGMENT_STAGE
out float count;

void main() {
    count = 1.0;
}
#endif
