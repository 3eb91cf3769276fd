// Draws leaves on cards of their own. Where a pixel has 4 samples their outline is tested at each, as that of a modelled
// leaf is.
#ifdef FOUR_SAMPLES  // a variant of its own: a software renderer runs both sides of every branch
#extension GL_ARB_sample_shading : require  // for gl_SampleMask
#endif
#include "leaf_triangles_corners.glsl"

#ifdef FRAGMENT_STAGE
uniform float focus;  // pixels that a unit takes up at a depth of one
uniform sampler2D leaf_color;
uniform sampler2D leaf_normal;

flat in vec4 image;
flat in vec4 thresholds;
flat in vec4 axes[3];
flat in vec2 texels;
flat in float side;
flat in vec4 seen_at;
in vec2 place;
in vec3 point;

layout(location = 0) out vec4 color;
layout(location = 1) out vec4 depth;

#include "lighting.glsl"
#ifdef FOUR_SAMPLES
#include "samples.glsl"
const float SPACING = 0.5;  // of samples, pixels
#else
const float SPACING = 1.0;
#endif

const float MOST_LOD = 4.0;  // mips keep the images of the leaves apart so far

bool on_card(vec2 at) {
    return all(lessThanEqual(abs(at), vec2(1.0)));
}

vec2 in_image(vec2 at, vec2 inner) {
    vec2 unit = clamp(at * 0.5 + 0.5, 0.0, 1.0);
    vec2 size = abs(image.zw);
    vec2 from_corner = clamp(unit * size, inner, size - inner);
    return image.xy + from_corner * sign(image.zw);
}

void main() {
    float range = 1.0 / gl_FragCoord.w;
    bool twig = axes[2].w > 0.5;
    vec2 atlas = vec2(textureSize(leaf_color, 0));
    vec2 size = abs(image.zw) * atlas;
    // A leaf's slant does not count: what is lost in detail would be gained in holes.
    float dense = max(texels.x * atlas.x, texels.y * atlas.y) * 0.5 * range / focus;  // texels to a pixel
    float most = clamp(log2(max(min(size.x, size.y), 1.0)) - 2.0, 0.0, MOST_LOD);  // the image is four texels wide there
    float lod = clamp(log2(max(dense * SPACING, 1e-6)), 0.0, most);
    float threshold = lod < 1.0 ? mix(0.5, thresholds.x, lod)
                    : lod < 2.0 ? mix(thresholds.x, thresholds.y, lod - 1.0)
                    : lod < 3.0 ? mix(thresholds.y, thresholds.z, lod - 2.0)
                                : mix(thresholds.z, thresholds.w, lod - 3.0);
    vec2 inner = min(0.5 * exp2(ceil(lod)) / atlas, abs(image.zw) / 2.0);
#ifdef FOUR_SAMPLES
    vec2 dx = dFdx(place);
    vec2 dy = dFdy(place);
    int passed = 0;
    vec3 sum = vec3(0.0);
    for (int i = 0; i < 4; ++i) {
        vec2 at = place + SAMPLES[i].x * dx + SAMPLES[i].y * dy;
        float alpha = textureLod(leaf_color, in_image(at, inner), lod).a;
        if (!on_card(at) || !twig && alpha < threshold) continue;
        passed |= 1 << i;
        sum += vec3(at, 1.0);
    }
    gl_SampleMask[0] = passed;
    vec2 seen = sum.xy / max(sum.z, 1.0);  // of the pixel's center there may be nothing
#else
    vec2 seen = place;
#endif
    vec2 uv = in_image(seen, inner);
    vec4 texel = textureLod(leaf_color, uv, lod);
#ifndef FOUR_SAMPLES
    if (!on_card(seen) || !twig && texel.a < threshold) discard;
#endif
    vec2 bump = textureLod(leaf_normal, uv, lod).rg * 2.0 - 1.0;
    bump.x *= sign(image.z);
    vec3 normal = side * (bump.x * axes[0].xyz - bump.y * axes[1].xyz
                          - sqrt(max(1.0 - dot(bump, bump), 0.0)) * axes[2].xyz);
    if (twig) normal = seen.x * axes[0].xyz - side * sqrt(max(1.0 - seen.x * seen.x, 0.0)) * axes[2].xyz;
    vec2 across = mix(seen_at.xw, seen_at.yz, 0.5 + 0.5 * seen.x);
    float sky_seen = mix(across.x, across.y, 0.5 + 0.5 * seen.y);
    color = vec4(lit(Surface(texel.rgb, normalize(normal), point, sky_seen, !twig)), 1.0);
    depth = vec4(range, 0.0, 0.0, 1.0);
}
#endif
