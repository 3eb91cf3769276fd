// Draws view impostors of trees so far away that each layer of a view can be taken for flat: where a layer is looked up
// follows from the corners of the card.
#define FLAT
#include "views_card.glsl"

#ifdef FRAGMENT_STAGE
uniform bool hemi;
uniform int layers;
uniform float brightness;
uniform float exposure;
uniform sampler2D coverage;
uniform sampler2D albedo;
uniform sampler2D relief;
uniform sampler2D occlusion;
uniform sampler2D pictures;

flat in ivec3 chosen;
flat in vec3 shares;
flat in mat3 axes;
flat in vec3 middle;
flat in float opacity;
in vec3 point;
in vec2 uv[FLAT_LAYERS];

layout(location = 0) out vec4 color;
layout(location = 1) out vec4 depth;

#include "lighting.glsl"
#include "slopes.glsl"

void main() {
    float correction = 1.0 + brightness * (1.0 - max(shares.x, max(shares.y, shares.z)));
    vec4 sum = vec4(0.0);
    float through = 1.0;
    for (int i = 0; i < (hemi ? 3 : 2); ++i) {
        int row = chosen[i] * layers;
        mat3 frame = axes * mat3(texelFetch(pictures, ivec2(0, row), 0).xyz, texelFetch(pictures, ivec2(1, row), 0).xyz,
                                 texelFetch(pictures, ivec2(2, row), 0).xyz);
        vec4 found = vec4(0.0);
        for (int layer = 0; layer < layers; ++layer) {
            int n = i * layers + layer;
            vec4 texels = texelFetch(pictures, ivec2(4, row + layer), 0);
            bool inside = uv[n] == clamp(uv[n], min(texels.xy, texels.zw), max(texels.xy, texels.zw));
            vec2 slope = (texture(relief, uv[n]).rg * 2.0 - 1.0) * STEEPEST;
            Surface surface = Surface(exposure * texture(albedo, uv[n]).rgb, frame * vec3(slope, 1.0),
                                      middle + axes * point, texture(occlusion, uv[n]).r, true);
            vec3 light = lit_softly(surface);
            float covered = texture(coverage, uv[n]).r;
            if (inside) found += (1.0 - found.a) * covered * vec4(light, 1.0);
        }
        found *= min(correction * shares[i], 1.0);
        sum += found;
        through *= 1.0 - found.a;
    }
    if (sum.a < 1.0 / 255.0) discard;
    color = vec4(sum.rgb / sum.a, 1.0) * (1.0 - through) * opacity;
#ifdef CASTER
    if (color.a < CASTS) discard;
#endif
    depth = vec4(color.a / gl_FragCoord.w, 0.0, 0.0, color.a);
}
#endif
