// Draws slicings: looks into each slice, and blends it over what lies behind it ([J00] 2.3).
#include "slicings_quads.glsl"

#ifdef FRAGMENT_STAGE
uniform float exposure;  // of the light
uniform mat4 to_clip;

flat in vec4 bounds;
flat in vec4 texels;
flat in vec2 range;
flat in vec3 viewer;
flat in float opacity;
flat in int steps;
flat in mat3 frame;
flat in vec3 origin;
in vec2 place;

layout(location = 0) out vec4 color;
layout(location = 1) out vec4 depth;

#include "lighting.glsl"
#include "relief.glsl"

void main() {
    float height;
    vec2 slope;
    float seen;
    float density = (texels.z - texels.x) / (bounds.z - bounds.x) * float(textureSize(coverage, 0).x);
    vec2 way = (viewer.xy - place) / viewer.z;
    Picture picture = Picture(bounds, texels, range, 0.0);
    vec4 found = look_into(picture, place, way, lod_of(dFdx(place), dFdy(place), density), steps, height, slope, seen);
    if (found.a == 0.0) discard;
#ifdef CASTER
    if (found.a * opacity < CASTS) discard;
#endif
    vec3 point = origin + frame * vec3(place + way * height, height);
    vec4 clip = to_clip * vec4(point, 1.0);
    gl_FragDepth = clip.z / clip.w * 0.5 + 0.5;
    Surface surface = Surface(exposure * found.rgb / found.a, frame * vec3(slope, 1.0), point, seen, true);
    vec3 light = lit_softly(surface);
    color = vec4(light, 1.0) * (found.a * opacity);
    depth = vec4(clip.w * color.a, 0.0, 0.0, color.a);
}
#endif
