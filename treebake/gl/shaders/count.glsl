// Counts the fragments that a mesh asks a client to shade, hidden and alpha-tested ones too.

#ifdef VERTEX_STAGE
uniform mat4 to_clip;

#include "grove.glsl"

in vec3 in_position;

void main() {
    gl_Position = to_clip * vec4(turned_point(in_position), 1.0);
}
#endif

#ifdef FRAGMENT_STAGE
out float count;

void main() {
    count = 1.0;
}
#endif
