// Draws glTF materials as a stock real-time client does, lit as lighting.glsl tells, out in linear light. With
// EXACT_CUTOUTS it cuts MASK out as if the leaf were modelled, not as a client with mipmaps does.

#ifdef EXACT_CUTOUTS  // a variant of its own: a software renderer runs both sides of every branch
#extension GL_ARB_sample_shading : require  // for gl_SampleMask
#endif

#ifdef VERTEX_STAGE
uniform mat4 to_clip;

#include "grove.glsl"

in vec3 in_position;
in vec3 in_normal;
in vec2 in_uv;
in vec2 in_occlusion_uv;
in float in_occlusion;  // the part of the sky that the vertex sees

flat out float opacity;
out vec3 position;
out vec3 normal;
out vec2 uv;
out vec2 occlusion_uv;
out float occlusion;
centroid out float range;

void main() {
    opacity = in_opacity;
    position = turned_point(in_position);
    normal = turned(mat3(1.0)) * in_normal;
    uv = in_uv;
    occlusion_uv = in_occlusion_uv;
    occlusion = in_occlusion;
    gl_Position = to_clip * vec4(position, 1.0);
    range = gl_Position.w;
}
#endif

#ifdef FRAGMENT_STAGE
const int OPAQUE = 0;
const int MASK = 1;
const int BLEND = 2;

#include "lighting.glsl"

uniform vec4 base_color;
uniform sampler2D color_map;  // sRGB: decoded before it is filtered
uniform sampler2D normal_map;
uniform sampler2D occlusion_map;
uniform bool has_normal_map;
uniform int alpha_mode;
uniform float alpha_cutoff;

flat in float opacity;
in vec3 position;
in vec3 normal;
in vec2 uv;
in vec2 occlusion_uv;
in float occlusion;
centroid in float range;  // extrapolated to a pixel's centre it would run off

layout(location = 0) out vec4 color;  // premultiplied
layout(location = 1) out vec4 depth;  // premultiplied, along the optical axis; only x is kept

#include "normal_map.glsl"
#include "fade.glsl"

#ifdef EXACT_CUTOUTS
#include "samples.glsl"

// Tests the unfiltered alpha at each sample: returns the mean colour of those that pass, and their bits in `passed`.
vec4 cut_out(out int passed) {
    vec2 uv_dx = dFdx(uv);
    vec2 uv_dy = dFdy(uv);
    vec4 sum = vec4(0.0);
    passed = 0;
    for (int i = 0; i < 4; i++) {
        vec4 texel = base_color * textureLod(color_map, uv + SAMPLES[i].x * uv_dx + SAMPLES[i].y * uv_dy, 0.0);
        if (texel.a < alpha_cutoff) continue;
        sum += vec4(texel.rgb, 1.0);
        passed |= 1 << i;
    }
    return sum / max(sum.a, 1.0);
}
#endif

void main() {
    uint pixel = uint(gl_FragCoord.x) ^ uint(gl_FragCoord.y) << 16;
    if (faded(pixel, opacity)) discard;
    float side = gl_FrontFacing ? 1.0 : -1.0;
    vec4 albedo = base_color * texture(color_map, uv);
    vec3 facing = side * normalize(normal);
    if (has_normal_map) {
        vec3 bump = texture(normal_map, uv).xyz * 2.0 - 1.0;
        facing = bumped(facing, side, bump, dFdx(position), dFdy(position), dFdx(uv), dFdy(uv));
    }
#if defined(EXACT_CUTOUTS) && defined(CASTER)
    albedo = base_color * textureLod(color_map, uv, 0.0);  // a texel of a shadow map has one sample
#endif
#if defined(EXACT_CUTOUTS) && !defined(CASTER)
    gl_SampleMask[0] = ~0;
    if (alpha_mode == MASK) albedo = cut_out(gl_SampleMask[0]);
#else
    if (alpha_mode == MASK && albedo.a < alpha_cutoff) discard;
#endif

    float alpha = alpha_mode == BLEND ? albedo.a : 1.0;
#ifdef CASTER
    if (alpha_mode == BLEND && faded(pixel ^ uint(gl_PrimitiveID) * 0x85EBCA77u, alpha)) discard;
#endif
    float seen = occlusion * texture(occlusion_map, occlusion_uv).r;
    color = vec4(lit(Surface(albedo.rgb, facing, position, seen, true)) * alpha, alpha);
    depth = vec4(alpha * range, 0.0, 0.0, alpha);
}
#endif
