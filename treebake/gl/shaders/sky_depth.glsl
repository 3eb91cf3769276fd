// Draws how far a mesh reaches along a direction and against it, in one pass: both are maxima, kept by blending.
#ifdef VERTEX_STAGE
uniform mat3 turn;     // to right, up, along the direction
uniform vec3 middle;   // of the mesh's bounding sphere
uniform float radius;

in vec3 in_position;

out float along;  // -1..1

#ifdef CUT_OUT
in vec2 in_uv;
out vec2 uv;
#endif

void main() {
    vec3 place = turn * (in_position - middle) / radius;
    along = place.z;
    gl_Position = vec4(place, 1.0);
#ifdef CUT_OUT
    uv = in_uv;
#endif
}
#endif

#ifdef FRAGMENT_STAGE
in float along;

layout(location = 0) out vec2 out_reach;  // along the direction, against it

#ifdef CUT_OUT
in vec2 uv;
uniform sampler2D color_map;
uniform float base_alpha;

#include "cutout.glsl"
#endif

void main() {
#ifdef CUT_OUT
    if (cut_out(textureLod(color_map, uv, 0.0).a * base_alpha)) discard;  // unfiltered: mips thin what is cut out
#endif
    out_reach = vec2(along, -along);
}
#endif
