// Counts the rays that thick billboards ask to be looked up: one for each of a pixel's four samples.
#include "indirect_box.glsl"

#ifdef FRAGMENT_STAGE
out float count;

void main() {
    count = 4.0;
}
#endif
