// Places the card of view impostors, of many trees in one call: it faces the viewer, and has 8 corners ([I11]). Chooses
// the pictures that are seen on it, and their shares.
// Coverage from which a view hides the sun, and of a caster one view alone is shown. Of a chestnut's shadow on the ground
// at 45 degrees, IoU with the source's, and the part of the sunlight that it takes from its own crown, the source's
// being 0.505: all views dithered 0.626 0.417; from 0.2 on 0.713 0.539; the nearest view, dithered 0.659 0.448; from 0.35
// on 0.745 0.527; from 0.5 on 0.739 0.499.
const float CASTS = 0.5;
const int FLAT_LAYERS = 9;  // of all views together that fit between the stages

#ifdef VERTEX_STAGE
uniform mat4 to_clip;
uniform vec3 eye;
uniform vec3 center;
uniform bool hemi;    // pictures lie on a hemi-octahedron, not around the tree
uniform int side;     // pictures along its side, or around the tree
uniform float radius; // of the sphere that holds the tree
uniform float focus;  // pixels that a unit takes up at a distance of one
uniform float support[33];

#include "grove.glsl"

flat out ivec3 chosen; // views
flat out vec3 shares;
flat out vec3 viewer;  // from the tree's center, as all below
flat out float pixels; // that a unit takes up
flat out mat3 axes;    // the tree's, in the world
flat out float opacity;
flat out vec3 middle;  // its center, in the world
out vec3 point;        // on the card
#ifdef FLAT
uniform int layers;
uniform sampler2D pictures;

out vec2 uv[FLAT_LAYERS];

// Where the point of the card is looked up in each layer, taken for flat at its middle depth.
void look_up() {
    for (int i = 0; i < (hemi ? 3 : 2) * layers; ++i) {
        int row = chosen[i / layers] * layers + i % layers;
        mat3 frame = mat3(texelFetch(pictures, ivec2(0, row), 0).xyz, texelFetch(pictures, ivec2(1, row), 0).xyz,
                          texelFetch(pictures, ivec2(2, row), 0).xyz);
        float plane = 0.5 * (texelFetch(pictures, ivec2(1, row), 0).w + texelFetch(pictures, ivec2(2, row), 0).w);
        uv[i] = vec2(-1.0);  // outside of any rectangle
        vec4 bounds = texelFetch(pictures, ivec2(3, row), 0);
        if (bounds.x == bounds.z) continue;
        vec4 texels = texelFetch(pictures, ivec2(4, row), 0);
        vec3 from = viewer * frame;
        vec3 at = point * frame;
        vec2 way = from.xy / max(from.z, 1e-3 * length(from));
        way *= min(1.0, 1.0 / max(length(way), 1e-6));
        vec2 place = at.xy - way * (at.z - plane);
        uv[i] = texels.xy + (place - bounds.xy) / (bounds.zw - bounds.xy) * (texels.zw - texels.xy);
    }
}
#endif

const float PI = 3.14159265359;
const float TAU = 2.0 * PI;
const float EIGHTH = TAU / 8.0;

// How far the tree reaches in a direction with this vertical part, as far as it is seen from the viewer's distance.
float reach(float up, float distance_) {
    float at = clamp(asin(clamp(up, -1.0, 1.0)) / PI + 0.5, 0.0, 1.0) * 32.0;
    int low = min(int(at), 31);
    float far = mix(support[low], support[low + 1], at - float(low));
    // What reaches less far and lies nearer the viewer may be seen farther out, up to the sphere's outline.
    far = min(far, radius * sqrt(1.0 - radius * radius / (distance_ * distance_)));
    return far * distance_ / (distance_ - sqrt(radius * radius - far * far));
}

void choose(vec3 way) {
    if (length(way.xz) < 1e-6) way = vec3(0.0, max(way.y, 0.0), 1e-6);  // straight above or below all azimuths are alike
    if (!hemi) {
        float around = atan(way.x, way.z) / TAU * float(side);
        float first = floor(around);
        chosen = (ivec3(int(first)) + ivec3(0, 1, 0) + 2 * side) % side;
        shares = vec3(1.0 - (around - first), around - first, 0.0);
        return;
    }
    way.y = max(way.y, 0.0);
    way /= abs(way.x) + abs(way.y) + abs(way.z);
    vec2 grid = (vec2(way.x + way.z, way.z - way.x) * 0.5 + 0.5) * float(side - 1);
    ivec2 low = ivec2(min(floor(grid), float(side - 2)));
    vec2 off = grid - vec2(low);
    bool right = off.x > off.y;
    int start = low.y * side + low.x;
    chosen = ivec3(start, start + (right ? 1 : side), start + side + 1);
    shares = vec3(1.0 - max(off.x, off.y), abs(off.x - off.y), min(off.x, off.y));
}

void main() {
    viewer = in_turn_back(eye) - center;
    float distance_ = length(viewer);
    vec3 way = viewer / distance_;
    choose(way);
#ifdef CASTER
    float most = max(shares.x, max(shares.y, shares.z));
    shares = most == shares.x ? vec3(1.0, 0.0, 0.0) : most == shares.y ? vec3(0.0, 1.0, 0.0) : vec3(0.0, 0.0, 1.0);
#endif
    vec3 right = length(way.xz) > 1e-6 ? normalize(vec3(way.z, 0.0, -way.x)) : vec3(1.0, 0.0, 0.0);
    vec3 up = cross(way, right);
    int triangle = gl_VertexID / 3;
    int corner = gl_VertexID % 3 == 0 ? 0 : triangle + gl_VertexID % 3;  // a fan
    float a = float(corner) * EIGHTH;
    float b = a + EIGHTH;
    float reaches[4];
    for (int i = 0; i < 4; ++i) reaches[i] = reach(up.y * sin(a + float(i - 1) * EIGHTH), distance_);
    // A side that its neighbours cut off would turn the outline inside out.
    float here = min(reaches[1], (reaches[0] + reaches[2]) / (2.0 * cos(EIGHTH)));
    float following = min(reaches[2], (reaches[1] + reaches[3]) / (2.0 * cos(EIGHTH)));
    vec2 place = (here * vec2(sin(b), -cos(b)) - following * vec2(sin(a), -cos(a))) / sin(EIGHTH);
    point = right * place.x + up * place.y;
    axes = turned(mat3(1.0));
    opacity = in_opacity;
    middle = turned_point(center);
    pixels = focus / distance_;
    gl_Position = distance_ > 1.001 * radius ? to_clip * vec4(middle + axes * point, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
#ifdef FLAT
    look_up();
#endif
}
#endif
