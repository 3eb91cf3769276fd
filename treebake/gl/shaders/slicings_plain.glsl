// Draws slicings of trees so far away that nothing in a slice is seen beside its place: a texture lookup a fragment.
#include "slicings_quads.glsl"

#ifdef FRAGMENT_STAGE
uniform float exposure;  // of the lit colours
uniform sampler2D coverage;
uniform sampler2D lit;

flat in vec4 bounds;
flat in vec4 texels;
flat in float opacity;
in vec2 place;

layout(location = 0) out vec4 color;
layout(location = 1) out vec4 depth;

void main() {
    vec2 uv = texels.xy + (place - bounds.xy) / (bounds.zw - bounds.xy) * (texels.zw - texels.xy);
    bool inside = place == clamp(place, bounds.xy, bounds.zw);
    vec3 light = exposure * texture(lit, uv).rgb;
    float covered = texture(coverage, uv).r;
    color = inside ? vec4(light, 1.0) * (covered * opacity) : vec4(0.0);
    depth = vec4(color.a / gl_FragCoord.w, 0.0, 0.0, color.a);
}
#endif
