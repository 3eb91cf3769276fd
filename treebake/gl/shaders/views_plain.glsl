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
uniform sampler2D lit;

flat in vec3 shares;
flat in vec4 limits[FLAT_LAYERS];
in vec2 uv[FLAT_LAYERS];
in float along;

layout(location = 0) out vec4 color;
layout(location = 1) out vec4 depth;

void main() {
    float correction = 1.0 + brightness * (1.0 - max(shares.x, max(shares.y, shares.z)));
    vec4 sum = vec4(0.0);
    float through = 1.0;
    for (int i = 0; i < (hemi ? 3 : 2); ++i) {
        vec4 found = vec4(0.0);
        for (int layer = 0; layer < layers; ++layer) {
            int n = i * layers + layer;
            bool inside = uv[n] == clamp(uv[n], limits[n].xy, limits[n].zw);
            vec3 light = texture(lit, uv[n]).rgb;
            float covered = texture(coverage, uv[n]).r;
            if (inside) found += (1.0 - found.a) * covered * vec4(light, 1.0);
        }
        found *= min(correction * shares[i], 1.0);
        sum += found;
        through *= 1.0 - found.a;
    }
    if (sum.a < 1.0 / 255.0) discard;
    color = vec4(exposure * sum.rgb / sum.a, 1.0) * (1.0 - through);
    depth = vec4(along * color.a, 0.0, 0.0, color.a);
}
#endif
