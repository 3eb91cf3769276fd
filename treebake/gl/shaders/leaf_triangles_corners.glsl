// Places the cards of leaves straight from their table, each in the corner of one triangle: on screen leaves are so small
// that a second triangle would cost more than the fragments beside the card.
#ifdef VERTEX_STAGE
uniform mat4 to_clip;
uniform vec3 eye;
uniform sampler2D cards;   // 3 texels each, 1024 cards in a row
uniform sampler2D ambient; // the part of the sky that the corners of each see: left top, right top, right bottom, left bottom
uniform sampler2D shapes;  // 4 texels a row: box and kind; image of the front; of the back; thresholds

#include "grove.glsl"
#include "fade.glsl"

flat out vec4 image;       // corner and size in texture coordinates, of the side that is seen; u runs as the place does
flat out vec4 thresholds;  // of the mips 1 to 4
flat out vec4 axes[3];     // right, down, away of the image, unit, in the world; the last one's w: whether it is a twig
flat out vec2 texels;      // of the image, across and down, to a unit of the world
flat out float side;       // -1 where the back is seen
flat out vec4 seen_at;     // the part of the sky that the corners see
out vec3 point;            // in the world
out vec2 place;            // on the card, -1..1, and beyond it

void main() {
    int number = gl_VertexID / 3;
    int corner = gl_VertexID % 3;
    place = vec2(corner == 1 ? 3.0 : -1.0, corner == 2 ? 3.0 : -1.0);
    ivec2 at = ivec2(3 * (number & 1023), number >> 10);
    vec4 middle = texelFetch(cards, at, 0);
    vec4 right = texelFetch(cards, at + ivec2(1, 0), 0);
    vec4 down = texelFetch(cards, at + ivec2(2, 0), 0);
    vec3 center = turned_point(middle.xyz);
    mat3 turn = turned(mat3(1.0));
    vec3 across = turn * right.xyz;
    vec3 along = turn * down.xyz;
    vec3 towards = eye - center;
    bool twig = down.w > 0.5;
    if (twig) {  // round: it faces every viewer
        vec3 facing = cross(towards, along);
        across = facing * (length(across) / max(length(facing), 1e-20));
    }
    vec2 half_ = vec2(length(across), length(along));
    vec3 away = normalize(cross(across, along));
    side = dot(towards, away) > 0.0 ? -1.0 : 1.0;
    int row = int(middle.w);
    image = texelFetch(shapes, ivec2(side < 0.0 && !twig ? 2 : 1, row), 0);
    seen_at = texelFetch(ambient, ivec2(number & 1023, number >> 10), 0);
    thresholds = texelFetch(shapes, ivec2(3, row), 0);
    texels = image.zw / half_;  // times half the atlas
    if (right.w < 0.0) image = vec4(image.x + image.z, image.y, -image.z, image.w);
    axes[0] = vec4(across / half_.x, 0.0);
    axes[1] = vec4(along / half_.y, 0.0);
    axes[2] = vec4(away, twig ? 1.0 : 0.0);
    bool shown = image.z != 0.0 && !faded(uint(number), in_opacity);  // a side that is never seen shows nothing
    point = center + place.x * across + place.y * along;
    gl_Position = shown ? to_clip * vec4(point, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
}
#endif
