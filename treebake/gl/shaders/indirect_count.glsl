// Counts the fragments that thick billboards ask to be looked up.
#include "indirect_box.glsl"

#ifdef FRAGMENT_STAGE
out float count;

void main() {
    count = 1.0;
}
#endif
