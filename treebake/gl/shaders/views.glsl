// Draws view impostors: looks into the views nearest the viewer and blends what it finds, cross-faded ([I11]).
#include "views_card.glsl"

#ifdef FRAGMENT_STAGE
uniform mat4 to_clip;
uniform bool hemi;
uniform float density;      // texels of a unit
uniform int layers;         // of a view, one behind the other
uniform float brightness;   // m of the correction 1 + m alpha_s, as for slicings
uniform float exposure;     // of the light
uniform sampler2D pictures;

flat in ivec3 chosen;
flat in vec3 shares;
flat in vec3 viewer;
flat in float pixels;
flat in mat3 axes;
flat in float opacity;
flat in vec3 middle;
in vec3 point;

layout(location = 0) out vec4 color;
layout(location = 1) out vec4 depth;

#include "lighting.glsl"
#include "relief.glsl"

const float OBLIQUE = 1.0;  // tangent of the angle to a view beyond which it is shown as from there
const int MOST_STEPS = 12;
const float STEP = 2.0;     // pixels that a step through a picture may shift what is seen

vec4 entry(int column, int row) {
    return texelFetch(pictures, ivec2(column, row), 0);
}

// Colour premultiplied by coverage of what one view shows. seen: mean place of it, premultiplied likewise.
vec4 look_at(int view, out vec3 seen) {
    int row = view * layers;
    mat3 frame = mat3(entry(0, row).xyz, entry(1, row).xyz, entry(2, row).xyz);
    vec3 from = viewer * frame;
    vec3 at = point * frame;
    vec2 way = (from.xy - at.xy) / max(from.z - at.z, 1e-3 * length(from));
    way *= min(1.0, OBLIQUE / max(length(way), 1e-6));
    vec2 place = at.xy - way * at.z;
    float lod = lod_of(dFdx(place), dFdy(place), density);
    vec4 sum = vec4(0.0);
    seen = vec3(0.0);
    for (int end = row + layers; row < end; ++row) {
        vec4 bounds = entry(3, row);
        if (bounds.x == bounds.z) continue;  // shows nothing
        vec2 range = vec2(entry(1, row).w, entry(2, row).w);
        Picture picture = Picture(bounds, entry(4, row), range, 0.5 * (range.x + range.y));
        float shift = (range.y - range.x) * length(way) * pixels;
        float height;
        vec2 slope;
        float sky_seen;
        int steps = clamp(int(ceil(shift / STEP)), 1, MOST_STEPS);
        vec4 found = look_into(picture, place, way, lod, steps, height, slope, sky_seen);
        vec3 there = frame * vec3(place + way * height, height);
        Surface surface = Surface(exposure * found.rgb / max(found.a, 1e-6), axes * (frame * vec3(slope, 1.0)),
                                  middle + axes * there, sky_seen, true);
        found = (1.0 - sum.a) * found.a * vec4(lit_softly(surface), 1.0);
        sum += found;
        seen += found.a * there;
    }
    return sum;
}

void main() {
    float correction = 1.0 + brightness * (1.0 - max(shares.x, max(shares.y, shares.z)));
    vec4 sum = vec4(0.0);
    vec3 place = vec3(0.0);
    float through = 1.0;
    for (int i = 0; i < (hemi ? 3 : 2); ++i) {
        vec3 seen;
        float share = min(correction * shares[i], 1.0);
        vec4 found = share * look_at(chosen[i], seen);
        sum += found;
        place += share * seen;
        through *= 1.0 - found.a;
    }
    if (sum.a < 1.0 / 255.0) discard;
    // Views show the same tree, so neither is in front: they are mixed by what each covers.
    color = vec4(sum.rgb / sum.a, 1.0) * (1.0 - through) * opacity;
#ifdef CASTER
    if (color.a < CASTS) discard;
#endif
    vec4 clip = to_clip * vec4(middle + axes * (place / sum.a), 1.0);
    gl_FragDepth = clip.z / clip.w * 0.5 + 0.5;
    depth = vec4(clip.w * color.a, 0.0, 0.0, color.a);
}
#endif
