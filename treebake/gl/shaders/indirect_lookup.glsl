// Looks a view ray up in multi-layered indirect textures ([GPSS07] 4.2, 5): hash -> lists -> placement -> leaf image.
// asset/FORMAT.md gives the tables; `treebake/lookup.py` is this file in numpy.
//
// A billboard's frame is (right, down, away), in hash cells from the corner of its box. A leaf's is that of its image,
// in halves of its own height.

uniform sampler2D billboards;      // 5 texels a row: see `Billboard`
uniform sampler2D shapes;          // 4 texels a row: box and kind; image of the front; of the back; thresholds
uniform usampler2D hash_texture;
uniform usampler2D lists_texture;
uniform usampler2D placements;
uniform sampler2D leaf_color;
uniform sampler2D leaf_normal;
uniform float largest;

const int MOST_CANDIDATES = 1024;  // leaves of a billboard whose boxes one ray meets
const int MOST_ENTRIES = 4096;     // list entries between two of them
const int MOST_CELLS = 4096;       // cells between two of those
const int LIST_BITS = 10;  // of a hash texel: the length of the list; the bits above are its offset
const int ROW_BITS = 10;   // of the number of an entry: its column in the table
const float MOST_LOD = 4.0;  // mips keep the images of the leaves apart so far
const float SOFTNESS = 0.0625;  // of the alpha test in mips: even areas are then kept in part
const int RELIEF_STEPS = 8;  // in which a ray looks for the relief of a leaf

struct Billboard {
    mat3 turn;     // from the tree's axes to the billboard's, times cells per unit
    vec3 shift;    // of the tree's origin, in cells
    vec3 size;     // of the box, in cells; z is its thickness
    float plane;   // how far behind the front the plane lies, in cells
    ivec2 origin;  // first texel in the hash texture
    int first;     // placement
    float reach;   // the most that a leaf sticks out of its centre along the normal, in cells
};

struct Leaf {
    vec3 center;  // in cells
    mat3 frame;   // columns right, down, away of the image, in the billboard's frame
    float scale;  // cells per half height
    vec3 half_;   // half the size of the leaf's box, in halves of its height
    bool rod;     // a twig, which turns its face to every viewer
    bool mirrored;
    int shape;
};

struct Hit {
    float along;    // the ray's parameter, 0..1
    int placement;  // -1 where nothing is hit
    vec2 place;     // in the leaf, -1..1 of its half sizes
    vec2 uv;        // in the leaves texture
    float lod;      // mip level there
    float away;     // behind the front, in cells
    bool behind;    // whether the leaf's back is seen
};

Billboard read_billboard(int index) {
    vec4 a = texelFetch(billboards, ivec2(0, index), 0);
    vec4 b = texelFetch(billboards, ivec2(1, index), 0);
    vec4 c = texelFetch(billboards, ivec2(2, index), 0);
    vec4 d = texelFetch(billboards, ivec2(3, index), 0);
    vec4 e = texelFetch(billboards, ivec2(4, index), 0);
    return Billboard(transpose(mat3(a.xyz, b.xyz, c.xyz)), vec3(a.w, b.w, c.w), d.xyz, d.w, ivec2(e.xy), int(e.z), e.w);
}

// Where a numbered entry of the lists or placements lies: 1024 to a row.
ivec2 in_rows(int number) {
    return ivec2(number & ((1 << ROW_BITS) - 1), number >> ROW_BITS);
}

// (1 + mantissa) * 2^-exponent of a few bits, the exponent above.
float small_float(uint bits, int mantissa) {
    uint exponent = bits >> mantissa;
    return uintBitsToFloat((127u - exponent) << 23 | (bits & (1u << mantissa) - 1u) << (23 - mantissa));
}

mat3 rotation(vec4 q) {
    vec3 t = 2.0 * q.xyz;
    vec3 s = t * q.xyz;
    vec3 m = t.xxy * q.yzz;
    vec3 w = t * q.w;
    return mat3(1.0 - s.y - s.z, m.x + w.z, m.y - w.y,
                m.x - w.z, 1.0 - s.x - s.z, m.z + w.x,
                m.y + w.y, m.z - w.x, 1.0 - s.x - s.y);
}

Leaf read_leaf(int number, vec3 size) {
    uvec4 word = texelFetch(placements, in_rows(number), 0);
    vec3 place = vec3(word.x & 0xFFFFu, word.x >> 16, word.y & 0xFFFFu) / 65535.0;
    float scale = largest * small_float(word.y >> 16, 12);
    float narrowing = small_float(word.z >> 26, 3);
    vec3 part = (vec3(word.z & 0x1FFFu, word.z >> 13 & 0x1FFFu, word.w & 0x1FFFu) / 8190.0 - 0.5) * sqrt(2.0);
    float rest = sqrt(max(1.0 - dot(part, part), 0.0));
    uint left_out = word.w >> 13 & 3u;
    vec4 quaternion = left_out == 0u ? vec4(rest, part)
                    : left_out == 1u ? vec4(part.x, rest, part.yz)
                    : left_out == 2u ? vec4(part.xy, rest, part.z)
                                     : vec4(part, rest);
    int shape = int(word.w >> 16);
    vec4 a = texelFetch(shapes, ivec2(0, shape), 0);
    return Leaf(place * size, rotation(quaternion), scale, a.xyz * vec3(narrowing, 1.0, 1.0), a.w > 0.5,
                (word.w >> 15 & 1u) > 0u, shape);
}

// A ray in a leaf's frame, and where it is in the leaf's box.
struct Meeting {
    vec3 from;
    vec3 go;
    float enter;
    float leave;
};

// Whether a ray passes through a leaf's box; a rod's is the rectangle that faces the ray.
bool meets_box(Leaf leaf, vec3 start, vec3 way, out Meeting at) {
    at.from = (start - leaf.center) * leaf.frame / leaf.scale;  // row vector times matrix: into the leaf's frame
    at.go = way * leaf.frame / leaf.scale;
    if (leaf.rod) {
        vec2 facing = at.go.xz / max(length(at.go.xz), 1e-12);
        at.enter = at.leave = -dot(at.from.xz, facing) / max(dot(at.go.xz, facing), 1e-12);
        vec3 point = at.from + at.enter * at.go;
        // From here on the rod is a flat leaf that lies across the ray.
        at.from = vec3(dot(point.xz, vec2(facing.y, -facing.x)), point.y, 0.0);
        at.go = vec3(0.0, 0.0, 1.0);
        return all(lessThanEqual(abs(at.from.xy), leaf.half_.xy));
    }
    vec3 inverse_ = 1.0 / mix(at.go, vec3(1e-12), lessThan(abs(at.go), vec3(1e-12)));
    vec3 one = (-leaf.half_ - at.from) * inverse_;
    vec3 other = (leaf.half_ - at.from) * inverse_;
    vec3 least = min(one, other);
    vec3 most = max(one, other);
    at.enter = max(max(least.x, least.y), least.z);
    at.leave = min(min(most.x, most.y), most.z);
    return at.enter <= at.leave;
}

// Where a place in a leaf lies in the leaves texture; `inner`: how far from the image's edge it stays.
vec2 in_image(Leaf leaf, vec4 image, vec2 place, vec2 inner) {
    vec2 unit = clamp(place / leaf.half_.xy * vec2(leaf.mirrored ? -0.5 : 0.5, 0.5) + 0.5, 0.0, 1.0);
    return image.xy + clamp(unit * image.zw, inner, image.zw - inner);
}

// How far behind the leaf's relief a ray is: negative before it.
float behind_relief(Leaf leaf, Meeting at, float along, vec4 image, vec2 inner) {
    vec3 point = at.from + along * at.go;
    float height = textureLod(leaf_normal, in_image(leaf, image, point.xy, inner), 0.0).b * 2.0 - 1.0;
    return point.z + height * leaf.half_.z;  // heights are towards the front's viewer
}

// Whether a leaf's image is opaque where a ray meets its relief; the hit is then moved there.
// spread: distance of samples, at the ray's parameters 1 and 0, in cells. dither: as of `look_up`.
bool meets_image(Leaf leaf, Meeting at, vec2 spread, float dither, inout Hit hit) {
    bool behind = at.go.z < 0.0;  // it moves against `away`
    vec4 image = texelFetch(shapes, ivec2(behind ? 2 : 1, leaf.shape), 0);
    vec2 size = leaf.half_.xy;
    vec2 atlas = vec2(textureSize(leaf_color, 0));
    // The derivative of the texture coordinates by the sample's place: a sample grows with the distance.
    float width = mix(spread.y, spread.x, at.enter) / leaf.scale;
    vec2 texels = image.zw * atlas;
    float most = clamp(log2(max(min(texels.x, texels.y), 1.0)) - 2.0, 0.0, MOST_LOD);  // the image is four texels wide there
    float lod = clamp(log2(max(width * max(texels.x / size.x, texels.y / size.y) / 2.0, 1e-6)), 0.0, most);
    vec4 thresholds = texelFetch(shapes, ivec2(3, leaf.shape), 0);  // at which mips 1 to 4 cover as much as mip 0
    float threshold = lod < 1.0 ? mix(0.5, thresholds.x, lod)
                    : lod < 2.0 ? mix(thresholds.x, thresholds.y, lod - 1.0)
                    : lod < 3.0 ? mix(thresholds.y, thresholds.z, lod - 2.0)
                                : mix(thresholds.z, thresholds.w, lod - 3.0);
    threshold += (2.0 * dither - 1.0) * SOFTNESS * min(lod, 1.0);
    vec2 inner = min(0.5 * exp2(ceil(lod)) / atlas, image.zw / 2.0);

    // The first step in which the ray changes sides of the relief, and where in it.
    float along = at.enter;
    bool meets = true;
    if (leaf.half_.z > 0.0 && !leaf.rod) {
        meets = false;
        float before = behind_relief(leaf, at, at.enter, image, inner);
        float stride = (at.leave - at.enter) / float(RELIEF_STEPS);
        for (int i = 0; i < RELIEF_STEPS; ++i) {
            float after = behind_relief(leaf, at, along + stride, image, inner);
            if ((before < 0.0) != (after < 0.0)) {
                behind = before > 0.0;
                along += stride * before / (before - after);
                meets = true;
                break;
            }
            along += stride;
            before = after;
        }
    }
    vec2 place = at.from.xy + along * at.go.xy;
    vec2 uv = in_image(leaf, image, place, inner);
    bool opaque = meets && image.z > 0.0 && along > 0.0 && along < hit.along && all(lessThanEqual(abs(place), size))
                  && (leaf.rod || textureLod(leaf_color, uv, lod).a >= threshold);
    if (opaque) {
        hit.along = along;
        hit.place = place / size;
        hit.uv = uv;
        hit.lod = lod;
        hit.behind = behind;
    }
    return opaque;
}

// Walks a ray through the cells of a billboard and returns the nearest leaf that it meets.
// share: of each list that is looked up, 0..1, from the viewer's end. dither: 0..1, by which what is true in part is decided: a
// broken number of entries, alpha in mips.
Hit look_up(Billboard board, vec3 start, vec3 way, vec2 spread, float share, float dither) {
    Hit hit = Hit(1.0, -1, vec2(0.0), vec2(0.0), 0.0, 0.0, false);
    // Where the ray is in the box.
    vec3 inverse_ = 1.0 / mix(way, vec3(1e-12), lessThan(abs(way), vec3(1e-12)));
    vec3 one = -start * inverse_;
    vec3 other = (board.size - start) * inverse_;
    vec3 enter = min(one, other);
    vec3 leave = max(one, other);
    float entry = max(max(enter.x, enter.y), max(enter.z, 0.0));
    float exit_ = min(min(leave.x, leave.y), leave.z);
    if (board.size.z == 0.0) exit_ = entry = enter.z;
    ivec2 cells = ivec2(board.size.xy);
    ivec2 cell = clamp(ivec2(floor(start.xy + entry * way.xy)), ivec2(0), cells - 1);
    ivec2 step_ = ivec2(sign(inverse_.xy));
    vec2 next = (vec2(cell + max(step_, 0)) - start.xy) * inverse_.xy;
    bool front = way.z > 0.0;

    uint texel = texelFetch(hash_texture, board.origin + cell, 0).r;
    int count = int(texel & ((1u << LIST_BITS) - 1u));  // of the cell's list
    int wanted = int(share * float(count) + dither);
    int entered = 0;  // entries that were looked up
    bool inside = entry <= exit_;
    for (int candidates = 0; inside && candidates < MOST_CANDIDATES; ++candidates) {
        // Find the next leaf whose box the ray meets. Images are read in the outer loop only: processors that run many
        // rays in step would else read one for every entry.
        Leaf leaf;
        Meeting at;
        int placement = -1;
        for (int walked = 0; walked < MOST_ENTRIES; ++walked) {
            for (int crossed = 0; entered >= wanted && inside && crossed < MOST_CELLS; ++crossed) {
                float turn = min(next.x, next.y);
                int axis = next.x < next.y ? 0 : 1;
                cell[axis] += step_[axis];
                next[axis] += abs(inverse_[axis]);
                inside = turn <= exit_ && hit.along > turn && cell[axis] >= 0 && cell[axis] < cells[axis];
                texel = texelFetch(hash_texture, board.origin + clamp(cell, ivec2(0), cells - 1), 0).r;
                count = int(texel & ((1u << LIST_BITS) - 1u));
                wanted = int(share * float(count) + dither);
                entered = 0;
            }
            if (!inside || entered >= wanted) break;
            int number = int(texel >> LIST_BITS) + (front ? entered : count - 1 - entered);
            ++entered;
            int found = board.first + int(texelFetch(lists_texture, in_rows(number), 0).r);
            leaf = read_leaf(found, board.size);
            // Lists are ordered by centres: once no later leaf can reach before the hit, the rest is left.
            float nearest = (front ? leaf.center.z : -leaf.center.z) - board.reach;
            if (hit.placement >= 0 && nearest >= (front ? hit.away : -hit.away)) {
                entered = wanted;
            } else if (meets_box(leaf, start, way, at)) {
                placement = found;
                break;
            }
        }
        if (placement >= 0 && meets_image(leaf, at, spread, dither, hit)) {
            hit.placement = placement;
            hit.away = start.z + hit.along * way.z;
        }
    }
    return hit;
}
