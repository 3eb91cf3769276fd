// Places the quads of slicings, of many trees in one call: for each tree the two nearest the viewer, and from above a
// third, blended ([J00] 2.3). Quads come furthest slice first, in each step that of the slicing seen from above, of the
// secondary one, of the primary one.

// Coverage from which a slice hides the sun. Of a chestnut's shadow on the ground at 45 degrees, IoU with the source's;
// and the part of the sunlight that it takes from its own crown, the source's being 0.505:
// dithered 0.675 0.454; from 0.2 on 0.756 0.620; 0.3 0.736 0.552; 0.4 0.696 0.484; the nearest slicing alone 0.679 0.458.
const float CASTS = 0.35;

#ifdef VERTEX_STAGE
uniform mat4 to_clip;
uniform vec3 eye;
uniform vec3 center;      // that all slicings share
uniform int orientations; // slicings around the tree
uniform int count;        // slices of a slicing
uniform int rectangles;   // of a slice
uniform int blended;      // slicings drawn for each tree: 2, or 3 where one seen from above is among them
uniform int dropped;      // of the furthest slices
uniform int far_row;      // where slicings of one slice each start
uniform float far_height; // pixels of the foliage's size below which those are drawn
uniform float size;       // of the foliage
uniform float brightness;
uniform float focus;      // pixels that a unit takes up at a distance of one
uniform sampler2D slices;

#include "grove.glsl"

flat out vec4 bounds;
flat out vec4 texels;
flat out vec2 range;
flat out vec3 viewer;  // in the slice's frame, from its plane
flat out float opacity;
flat out int steps;
flat out mat3 frame;   // right, up, towards the viewer, in the world
flat out vec3 origin;  // of the slice's frame
out vec2 place;        // on the slice

const float ABOVE = 30.0, HIGH = 60.0;  // degrees of elevation between which the slicing seen from above takes over
const int MOST_STEPS = 16;
const float STEP = 2.0;  // pixels that a step through a slice may shift what is seen
const float TAU = 6.28318530718;
const vec2 CORNERS[6] = vec2[](vec2(0, 0), vec2(1, 0), vec2(1, 1), vec2(0, 0), vec2(1, 1), vec2(0, 1));

void main() {
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);  // unless the quad is seen
    vec3 seen = in_turn_back(eye) - center;
    float around = atan(seen.x, seen.z) / TAU * float(orientations);
    float nearest = floor(around + 0.5);
    float next = nearest + (around >= nearest ? 1.0 : -1.0);
    float second = abs(around - nearest);  // 0 facing the nearest, 1/2 midway
    float elevation = degrees(atan(seen.y, length(seen.xz)));
    float above = blended == 3 ? clamp((elevation - ABOVE) / (HIGH - ABOVE), 0.0, 1.0) : 0.0;
    vec3 weights = vec3(above, (1.0 - above) * second, (1.0 - above) * (1.0 - second));

    int quad = gl_VertexID / 6;
    int step_ = quad / (blended * rectangles);
    int which = quad / rectangles % blended + 3 - blended;
    float pixels = focus / length(seen);  // that a unit takes up
    bool far = size * pixels < far_height;
    if (far ? step_ > 0 : step_ < dropped) return;
    float most = max(weights.x, max(weights.y, weights.z));
    opacity = min((1.0 + brightness * (1.0 - most)) * weights[which], 1.0) * in_opacity;
    if (opacity <= 0.0) return;

    int slicing = which == 0 ? orientations : (int(which == 1 ? next : nearest) + 2 * orientations) % orientations;
    int row = far ? far_row + slicing : slicing * count + step_;
    vec4 right = texelFetch(slices, ivec2(0, row), 0);
    vec4 up = texelFetch(slices, ivec2(1, row), 0);
    vec4 towards = texelFetch(slices, ivec2(2, row), 0);
    int column = 3 + 2 * (quad % rectangles);
    bounds = texelFetch(slices, ivec2(column, row), 0);
    texels = texelFetch(slices, ivec2(column + 1, row), 0);
    range = vec2(up.w, towards.w);
    viewer = vec3(dot(seen, right.xyz), dot(seen, up.xyz), dot(seen, towards.xyz) - right.w);
    float before = max(range.x, range.y);
    float behind = min(range.x, range.y);
    if (bounds.x == bounds.z || viewer.z <= before) return;  // empty, or not before the slice

    vec2 farthest = max(abs(bounds.xy - viewer.xy), abs(bounds.zw - viewer.xy));
    float shift = (before - behind) * length(farthest) / viewer.z;
    steps = clamp(int(ceil(shift * pixels / STEP)), 1, MOST_STEPS);
    // What lies before or behind the plane is seen beside its place: the rectangle is widened by that.
    vec4 off = bounds - viewer.xyxy;
    vec4 nearer = off * before / (viewer.z - before);
    vec4 farther = off * behind / (viewer.z - behind);
    vec4 wide = bounds + vec4(min(min(nearer.xy, farther.xy), 0.0), max(max(nearer.zw, farther.zw), 0.0));
    place = mix(wide.xy, wide.zw, CORNERS[gl_VertexID % 6]);
    frame = turned(mat3(right.xyz, up.xyz, towards.xyz));
    origin = turned_point(center + towards.xyz * right.w);
    gl_Position = to_clip * vec4(origin + frame * vec3(place, 0.0), 1.0);
}
#endif

