// Draws slicings of trees so far away that nothing in a slice is seen beside its place: one lookup of each image a fragment.
#include "slicings_quads.glsl"

#ifdef FRAGMENT_STAGE
uniform float exposure;  // of the light
uniform sampler2D coverage;
uniform sampler2D albedo;
uniform sampler2D relief;

flat in vec4 bounds;
flat in vec4 texels;
flat in vec2 range;
flat in float opacity;
flat in mat3 frame;
in vec2 place;

layout(location = 0) out vec4 color;
layout(location = 1) out vec4 depth;

#include "lighting.glsl"
#include "slopes.glsl"

void main() {
    vec2 uv = texels.xy + (place - bounds.xy) / (bounds.zw - bounds.xy) * (texels.zw - texels.xy);
    bool inside = place == clamp(place, bounds.xy, bounds.zw);
    vec2 slope = slopes_of(texture(relief, uv).rg, range);
    vec3 light = lit_softly(exposure * texture(albedo, uv).rgb, frame * vec3(slope, 1.0));
    float covered = texture(coverage, uv).r;
    color = inside ? vec4(light, 1.0) * (covered * opacity) : vec4(0.0);
    depth = vec4(color.a / gl_FragCoord.w, 0.0, 0.0, color.a);
}
#endif
