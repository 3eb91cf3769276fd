// Places the card of view impostors, of many trees in one call: it faces the viewer, and has 8 corners ([I11]). Chooses
// the pictures that are seen on it, and their shares.
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
flat out vec3 middle;  // its center, in the world
out vec3 point;        // on the card

const float TAU = 6.28318530718;
const float EIGHTH = TAU / 8.0;

// How far the tree reaches in a direction with this vertical part, as far as it is seen from the viewer's distance.
float reach(float up, float distance_) {
    float at = clamp(up * 0.5 + 0.5, 0.0, 1.0) * 32.0;
    int low = min(int(at), 31);
    float far = mix(support[low], support[low + 1], at - float(low));
    float nearer = sqrt(max(radius * radius - far * far, 0.0));  // what reaches so far can be no nearer to the viewer
    return far * distance_ / max(distance_ - nearer, 0.1 * distance_);
}

void choose(vec3 way) {
    if (!hemi) {
        float around = atan(way.x, way.z) / TAU * float(side);
        float first = floor(around);
        chosen = ivec3(int(mod(first, float(side))), int(mod(first + 1.0, float(side))), 0);
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
    vec3 right = length(way.xz) > 1e-6 ? normalize(vec3(way.z, 0.0, -way.x)) : vec3(1.0, 0.0, 0.0);
    vec3 up = cross(way, right);
    int triangle = gl_VertexID / 3;
    int corner = gl_VertexID % 3 == 0 ? 0 : triangle + gl_VertexID % 3;  // a fan
    float a = float(corner) * EIGHTH;
    float b = a + EIGHTH;
    vec2 place = (reach(up.y * sin(a), distance_) * vec2(sin(b), -cos(b))
                  - reach(up.y * sin(b), distance_) * vec2(sin(a), -cos(a))) / sin(EIGHTH);
    point = right * place.x + up * place.y;
    axes = turned(mat3(1.0));
    middle = turned_point(center);
    pixels = focus / distance_;
    gl_Position = distance_ > radius ? to_clip * vec4(middle + axes * point, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
}
#endif
