// Looks into one picture of an atlas as if what it shows lay where it was when the picture was taken: the view ray is
// followed through the picture's depth in steps, as if every picture were a stack of thinner ones.

uniform sampler2D coverage;
uniform sampler2D albedo;  // half as wide and high, as is the next
uniform sampler2D relief;  // slopes of the surface in RG, depth in B
uniform sampler2D occlusion;  // the part of the sky that is seen

#include "slopes.glsl"

struct Picture {
    vec4 bounds;  // left, bottom, right, top, in the picture's frame
    vec4 texels;  // texture coordinates at (left, bottom) and (right, top)
    vec2 range;   // depths towards the viewer that 0 and 1 stand for; the greater first in a picture seen from behind
    float plane;  // depth at which all of it lies where it is not followed in steps
};

// Albedo premultiplied by coverage, of the ray that meets depth 0 at `place` and moves by `way` for each unit towards the
// viewer. lod: mip of the coverage. height, slope, sky: mean depth and slopes of what is seen, and of the sky that it sees.
vec4 look_into(Picture picture, vec2 place, vec2 way, float lod, int steps, out float height, out vec2 slope, out float sky) {
    vec2 scale = (picture.texels.zw - picture.texels.xy) / (picture.bounds.zw - picture.bounds.xy);
    vec2 origin = picture.texels.xy - picture.bounds.xy * scale;
    float half_lod = max(lod - 1.0, 0.0);
    float nearest = max(picture.range.x, picture.range.y);
    float thick = abs(picture.range.y - picture.range.x) / float(steps);
    float farthest = nearest - (float(steps) - 0.5) * thick;
    float left = 1.0;  // of the ray's light
    height = 0.0;
    slope = vec2(0.0);
    for (int i = 0; i < steps; ++i) {
        float depth = steps == 1 ? picture.plane : nearest - (float(i) + 0.5) * thick;
        vec2 at = place + way * depth;
        vec2 uv = origin + at * scale;
        vec3 surface = textureLod(relief, uv, half_lod).rgb;
        float there = mix(picture.range.x, picture.range.y, surface.b);
        float part = textureLod(coverage, uv, lod).r;
        vec2 steep = slopes_of(surface.rg, picture.range);
        // A depth between two steps belongs to both in parts, which add up to one; the first and last own their ends. On
        // a slope the ray comes nearer by more than a step at a time, of which as much is made up for as does not blur.
        float nearing = clamp(abs(1.0 + dot(steep, way)), 1.0, 1.25);
        float off = abs(clamp(there, farthest, nearest - 0.5 * thick) - depth);
        part *= steps == 1 ? 1.0 : max(1.0 - off / (thick * nearing), 0.0);
        part = at == clamp(at, picture.bounds.xy, picture.bounds.zw) ? min(part, left) : 0.0;
        left -= part;
        height += part * there;
        slope += part * steep;
    }
    float sum = 1.0 - left;
    height /= max(sum, 1e-6);
    slope /= max(sum, 1e-6);
    vec2 uv = origin + (place + way * (steps == 1 ? picture.plane : height)) * scale;
    vec3 color = textureLod(albedo, uv, half_lod).rgb;
    sky = textureLod(occlusion, uv, max(lod - 3.0, 0.0)).r;
    // A surface turned to the viewer covers more than it did in the picture, one turned away less.
    float turned = abs(dot(vec3(slope, 1.0), normalize(vec3(way, 1.0))));
    sum = 1.0 - pow(1.0 - sum, max(turned, 1e-3));
    return sum * vec4(color, 1.0);
}

// The mip of the coverage where a place changes by dx and dy from pixel to pixel. density: texels to a unit.
float lod_of(vec2 dx, vec2 dy, float density) {
    return max(0.5 * log2(max(max(dot(dx, dx), dot(dy, dy)) * density * density, 1e-12)), 0.0);
}
