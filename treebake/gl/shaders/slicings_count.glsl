// Counts the fragments that slicings ask a client to shade.
#include "slicings_quads.glsl"

#ifdef FRAGMENT_STAGE
out float count;

void main() {
    count = 1.0;
}
#endif
