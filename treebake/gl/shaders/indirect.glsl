// Draws billboards of multi-layered indirect textures: the boxes' back faces are rasterised, and every sample casts its
// view ray into the box. Lit as lit.glsl lights meshes.
#extension GL_ARB_sample_shading : require

#include "indirect_box.glsl"

#ifdef FRAGMENT_STAGE
#include "lighting.glsl"
#include "indirect_lookup.glsl"
#include "fade.glsl"

uniform mat4 to_clip;
uniform mat4 from_clip;
uniform vec2 window;       // pixels
uniform vec2 fade;         // width of a hash cell on screen, pixels: below x nothing is looked up, above y everything
uniform sampler2D ambient;  // the part of the sky that the corners of each leaf see
uniform sampler2D far_color;
uniform sampler2D far_normal;

flat in int billboard;
flat in vec4 standing;
flat in vec2 turning;
flat in float opacity;

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
    return (float(h >> 9) + 0.5) / 8388608.0;  // as many bits as stay below 1
}

// From a normal map's (right, up, towards the viewer) to (right, down, away).
vec3 unpacked(vec2 bump) {
    return vec3(bump.x, -bump.y, -sqrt(max(1.0 - dot(bump, bump), 0.0)));
}

// What is hit, its normal in the billboard's frame.
Surface leaf_surface(Billboard board, Hit hit, vec3 way) {
    Leaf leaf = read_leaf(hit.placement, board.size);
    vec3 normal = unpacked(textureLod(leaf_normal, hit.uv, hit.lod).rg * 2.0 - 1.0);
    if (leaf.mirrored) normal.x = -normal.x;
    if (leaf.rod) {  // round, and turned to the viewer
        vec2 facing = (way * leaf.frame).xz;
        facing /= max(length(facing), 1e-12);
        normal = unpacked(vec2(hit.place.x, 0.0));
        normal.xz = vec2(normal.x * facing.y + normal.z * facing.x, normal.z * facing.y - normal.x * facing.x);
    }
    vec4 corners = texelFetch(ambient, in_rows(hit.placement), 0);
    vec2 across = mix(corners.xw, corners.yz, 0.5 + 0.5 * hit.place.x);
    float seen = mix(across.x, across.y, 0.5 + 0.5 * hit.place.y);
    vec3 albedo = textureLod(leaf_color, hit.uv, hit.lod).rgb;
    return Surface(albedo, leaf.frame * (hit.behind ? -normal : normal), vec3(0.0), seen, !leaf.rod);
}

// Whether the low-resolution texture covers what the lists' missing entries would. It holds all entries; if layers hide
// each other by chance, a share of them lets the same share of the light's logarithm through.
bool meets_far(Billboard board, vec3 point, float share, float sample_width, bool behind, out Surface surface) {
    if (any(lessThan(point.xy, vec2(0.0))) || any(greaterThan(point.xy, board.size.xy))) return false;
    vec2 texels = vec2(textureSize(far_color, 0));
    vec2 cells = vec2(textureSize(hash_texture, 0));
    float most = log2(texels.x / cells.x);  // a texel a cell
    float lod = clamp(log2(sample_width) + most, 0.0, most);
    vec2 inner = 0.5 * exp2(ceil(lod)) * cells / texels;
    vec2 uv = (vec2(board.origin) + clamp(point.xy, inner, board.size.xy - inner)) / cells;
    vec4 texel = textureLod(far_color, uv, lod);
    vec4 more = textureLod(far_normal, uv, lod);
    vec3 normal = unpacked(more.rg * 2.0 - 1.0);
    surface = Surface(texel.rgb, behind ? -normal : normal, vec3(0.0), more.a, true);
    return 1.0 - pow(1.0 - texel.a, 1.0 - share) > dither(2 * billboard + 1);
}

void main() {
    Billboard board = read_billboard(billboard);
    // As if the tree stood upright at its own origin, in its own size, and the world were moved instead.
    mat3 turn = mat3(turning.x, 0.0, -turning.y, 0.0, 1.0, 0.0, turning.y, 0.0, turning.x);
    board.turn = board.turn * transpose(turn) / standing.w;
    board.shift -= board.turn * standing.xyz;
    vec2 place = (floor(gl_FragCoord.xy) + gl_SamplePosition) / window * 2.0 - 1.0;  // makes the shader run per sample
    vec3 near = unprojected(vec3(place, -1.0));
    vec3 far = unprojected(vec3(place, 1.0));
    vec3 start = board.turn * near + board.shift;
    vec3 way = board.turn * (far - near);
    // Half a pixel, the distance of samples, at the ends of the ray.
    vec3 half_pixel = vec3(1.0 / window.x, 0.0, 0.0);
    vec2 spread = vec2(length(unprojected(vec3(place, 1.0) + half_pixel) - far),
                       length(unprojected(vec3(place, -1.0) + half_pixel) - near)) * length(board.turn[0]);

    // The shader's level of detail: how much of the lists is looked up, by the width of a cell on screen.
    float at_plane = (board.plane - start.z) / way.z;
    float pixels = 0.5 / mix(spread.y, spread.x, clamp(at_plane, 0.0, 1.0));
    float share = clamp((pixels - fade.x) / (fade.y - fade.x), 0.0, 1.0);
    Hit hit = look_up(board, start, way, spread, share, dither(2 * billboard));
    Surface surface;
    if (hit.placement >= 0) {
        if (faded(uint(hit.placement), opacity)) discard;
        surface = leaf_surface(board, hit, way);
    } else if (share == 1.0 || at_plane <= 0.0 || at_plane >= 1.0 || !meets_far(board, start + at_plane * way, share, 0.5 / pixels, way.z < 0.0, surface)) {
        discard;
    } else {
        if (faded(uint(gl_FragCoord.x) ^ uint(gl_FragCoord.y) << 16, opacity)) discard;
        hit.along = at_plane;
    }
    surface.point = near + hit.along * (far - near);
    vec4 clip = to_clip * vec4(surface.point, 1.0);
    gl_FragDepth = clip.z / clip.w * 0.5 + 0.5;
    surface.normal = normalize(surface.normal * board.turn);  // transposed: back to the world's axes
    color = vec4(lit(surface), 1.0);
    depth = vec4(clip.w, 0.0, 0.0, 1.0);
}
#endif
