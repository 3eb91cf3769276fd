// Counts the fragments that leaves on cards of their own ask to be shaded.
#include "leaf_triangles_corners.glsl"

#ifdef FRAGMENT_STAGE
out float count;

void main() {
    count = 1.0;
}
#endif
