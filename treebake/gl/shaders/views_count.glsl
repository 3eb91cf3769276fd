// Counts the fragments that view impostors ask a client to shade.
#include "views_card.glsl"

#ifdef FRAGMENT_STAGE
out float count;

void main() {
    count = 1.0;
}
#endif
