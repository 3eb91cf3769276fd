// Draws slicings of trees so far away that nothing in a slice is seen beside its place: one lookup of each image a fragment.
#include "slicings_quads.glsl"

#ifdef FRAGMENT_STAGE
uniform float exposure;  // of the light
uniform sampler2D coverage;
uniform sampler2D albedo;
uniform sampler2D relief;
uniform sampler2D occlusion;

flat in vec4 bounds;
flat in vec4 texels;
flat in vec2 range;
flat in float opacity;
flat in mat3 frame;
flat in vec3 origin;
in vec2 place;

layout(location = 0) out vec4 color;
layout(location = 1) out vec4 depth;

#include "lighting.glsl"
#include "slopes.glsl"

void main() {
    vec2 uv = texels.xy + (place - bounds.xy) / (bounds.zw - bounds.xy) * (texels.zw - texels.xy);
    bool inside = place == clamp(place, bounds.xy, bounds.zw);
    vec2 slope = slopes_of(texture(relief, uv).rg, range);
    Surface surface = Surface(exposure * texture(albedo, uv).rgb, frame * vec3(slope, 1.0),
                              origin + frame * vec3(place, 0.0), texture(occlusion, uv).r, true);
    vec3 light = lit_softly(surface);
    float covered = texture(coverage, uv).r;
    color = inside ? vec4(light, 1.0) * (covered * opacity) : vec4(0.0);
#ifdef CASTER
    if (color.a < CASTS) discard;
#endif
    depth = vec4(color.a / gl_FragCoord.w, 0.0, 0.0, color.a);
}
#endif
