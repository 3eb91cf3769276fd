// The boxes of thick billboards, 36 vertices each, straight from their table.
#ifdef VERTEX_STAGE
uniform mat4 to_clip;
uniform sampler2D billboards;
flat out int billboard;
flat out vec4 standing;  // the tree's origin in the world, and its scale
flat out vec2 turning;   // cosine and sine of its turn
flat out float opacity;

#include "grove.glsl"

const int CORNERS[36] = int[](  // outward faces of a box whose corner i lies at (i & 1, i >> 1 & 1, i >> 2)
    0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4, 2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5);

void main() {
    billboard = gl_VertexID / 36;
    int corner = CORNERS[gl_VertexID % 36];
    vec4 a = texelFetch(billboards, ivec2(0, billboard), 0);
    vec4 b = texelFetch(billboards, ivec2(1, billboard), 0);
    vec4 c = texelFetch(billboards, ivec2(2, billboard), 0);
    vec3 size = texelFetch(billboards, ivec2(3, billboard), 0).xyz;
    vec3 local = vec3(corner & 1, corner >> 1 & 1, corner >> 2) * size - vec3(a.w, b.w, c.w);
    // The rows are at right angles and of one length, so their transpose is the inverse but for that length squared.
    vec3 position = (local.x * a.xyz + local.y * b.xyz + local.z * c.xyz) / dot(a.xyz, a.xyz);
    gl_Position = to_clip * vec4(turned_point(position), 1.0);
    standing = in_place;
    turning = in_turn;
    opacity = in_opacity;
}
#endif
