// Draws billboards of multi-layered indirect textures: the boxes' back faces are rasterised, and every sample casts its
// view ray into the box. Lit as lit.glsl lights meshes.
#extension GL_ARB_sample_shading : require

#ifdef VERTEX_STAGE
uniform mat4 to_clip;
uniform sampler2D billboards;
flat out int billboard;

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
    gl_Position = to_clip * vec4(position, 1.0);
}
#endif

#ifdef FRAGMENT_STAGE
#include "lighting.glsl"
#include "indirect_lookup.glsl"

uniform mat4 to_clip;
uniform mat4 from_clip;
uniform vec2 window;       // pixels
uniform vec2 fade;         // width of a hash cell on screen, pixels: below x nothing is looked up, above y everything
uniform sampler2D far_color;
uniform sampler2D far_normal;

flat in int billboard;

layout(location = 0) out vec4 color;
layout(location = 1) out vec4 depth;

vec3 unprojected(vec3 place) {
    vec4 point = from_clip * vec4(place, 1.0);
    return point.xyz / point.w;
}

// A number in 0..1 that differs between samples, pixels and `seed`, always the same for the same ones.
float dither(int seed) {
    uint h = uint(gl_FragCoord.x) * 0x9E3779B1u ^ uint(gl_FragCoord.y) * 0x85EBCA77u ^ uint(seed) * 0xC2B2AE3Du
           ^ uint(gl_SampleID) * 0x27D4EB2Fu;
    h ^= h >> 15;
    h *= 0x2C1B3C6Du;
    h ^= h >> 12;
    h *= 0x297A2D39u;
    h ^= h >> 15;
    return (float(h >> 8) + 0.5) / 16777216.0;
}

void main() {
    Billboard board = read_billboard(billboard);
    vec2 place = (floor(gl_FragCoord.xy) + gl_SamplePosition) / window * 2.0 - 1.0;  // makes the shader run per sample
    vec3 near = unprojected(vec3(place, -1.0));
    vec3 far = unprojected(vec3(place, 1.0));
    vec3 start = board.turn * near + board.shift;
    vec3 way = board.turn * (far - near);
    // Half a pixel, the distance of samples, at the ends of the ray.
    vec3 half_pixel = vec3(1.0 / window.x, 0.0, 0.0);
    vec2 spread = vec2(length(unprojected(vec3(place, 1.0) + half_pixel) - far),
                       length(unprojected(vec3(place, -1.0) + half_pixel) - near)) * length(board.turn[0]);

    Hit hit = look_up(board, start, way, spread, 1.0, 0.5);
    if (hit.placement < 0) discard;
    Leaf leaf = read_leaf(hit.placement, board.size);
    vec4 texel = textureLod(leaf_color, hit.uv, 0.0);
    vec3 bump = textureLod(leaf_normal, hit.uv, 0.0).rgb * 2.0 - 1.0;
    vec3 normal = vec3(bump.xy, sqrt(max(1.0 - dot(bump.xy, bump.xy), 0.0)));
    if (leaf.mirrored) normal.x = -normal.x;
    normal = vec3(normal.x, -normal.y, -normal.z);
    if (leaf.rod) {
        vec3 go = way * leaf.frame;
        vec2 facing = normalize(vec2(go.x, go.z));
        normal = vec3(normal.x * facing.y - normal.z * -facing.x, normal.y, -normal.x * facing.x + normal.z * facing.y);
    }
    if (hit.behind) normal = -normal;
    normal = normalize((leaf.frame * normal) * board.turn);  // transposed: back to the tree's axes
    vec3 position = near + hit.along * (far - near);
    vec4 clip = to_clip * vec4(position, 1.0);
    gl_FragDepth = clip.z / clip.w * 0.5 + 0.5;
    color = vec4(lit(texel.rgb, normal), 1.0);
    depth = vec4(clip.w, 0.0, 0.0, 1.0);
}
#endif
