// Looks a view ray up in multi-layered indirect textures ([GPSS07] 4.2, 5): hash -> lists -> placement -> leaf image.
// asset/FORMAT.md gives the tables; `treebake/lookup.py` is this file in numpy.
//
// A billboard's frame is (right, down, away), in hash cells from the corner of its box. A leaf's is that of its image,
// in halves of its own height.

uniform sampler2D billboards;      // 5 texels a row: see `Billboard`
uniform sampler2D shapes;          // 3 texels a row: see `Shape`
uniform usampler2D hash_texture;
uniform usampler2D lists_texture;
uniform usampler2D placements;
uniform sampler2D leaf_color;
uniform sampler2D leaf_normal;
uniform float largest;

const int MOST_CELLS = 256;  // that a ray walks through
const int RELIEF_STEPS = 3;  // the height is read that often; each reading halves the error of a bent leaf, or better

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
    vec4 front;   // place of the image in texture coordinates: corner, size
    vec4 back;
};

struct Hit {
    float along;   // the ray's parameter; beyond 1e29 nothing was hit
    int placement;
    vec2 uv;       // in the leaves texture
    float away;    // behind the front, in cells
    bool behind;   // whether the leaf's back is seen
};

Billboard read_billboard(int index) {
    vec4 a = texelFetch(billboards, ivec2(0, index), 0);
    vec4 b = texelFetch(billboards, ivec2(1, index), 0);
    vec4 c = texelFetch(billboards, ivec2(2, index), 0);
    vec4 d = texelFetch(billboards, ivec2(3, index), 0);
    vec4 e = texelFetch(billboards, ivec2(4, index), 0);
    return Billboard(transpose(mat3(a.xyz, b.xyz, c.xyz)), vec3(a.w, b.w, c.w), d.xyz, d.w, ivec2(e.xy), int(e.z), e.w);
}

ivec2 in_rows(int number, int width) {
    return ivec2(number % width, number / width);
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
    uvec4 word = texelFetch(placements, in_rows(number, textureSize(placements, 0).x), 0);
    vec3 place = vec3(word.x & 0xFFFFu, word.x >> 16, word.y & 0xFFFFu) / 65535.0;
    float scale = largest * exp2(-float(word.y >> 16) / 4096.0);
    float narrowing = exp2(-float(word.z >> 26) / 8.0);
    vec3 part = (vec3(word.z & 0x1FFFu, word.z >> 13 & 0x1FFFu, word.w & 0x1FFFu) / 8191.0 - 0.5) * sqrt(2.0);
    float rest = sqrt(max(1.0 - dot(part, part), 0.0));
    uint left_out = word.w >> 13 & 3u;
    vec4 quaternion = left_out == 0u ? vec4(rest, part)
                    : left_out == 1u ? vec4(part.x, rest, part.yz)
                    : left_out == 2u ? vec4(part.xy, rest, part.z)
                                     : vec4(part, rest);
    int shape = int(word.w >> 16);
    vec4 a = texelFetch(shapes, ivec2(0, shape), 0);
    vec3 half_ = a.xyz * vec3(narrowing, 1.0, 1.0);
    return Leaf(place * size, rotation(quaternion), scale, half_, a.w > 0.5, (word.w >> 15 & 1u) > 0u,
                texelFetch(shapes, ivec2(1, shape), 0), texelFetch(shapes, ivec2(2, shape), 0));
}

// Where a ray meets a leaf: false where it passes by, or where the image is clear.
// `spread`: half a sample's width on the ray's way at parameter 1 and at 0, in cells.
bool meets_leaf(Leaf leaf, vec3 start, vec3 way, vec2 spread, float threshold, inout Hit hit) {
    vec3 from = (start - leaf.center) * leaf.frame / leaf.scale;  // row vector times matrix: into the leaf's frame
    vec3 go = way * leaf.frame / leaf.scale;
    float along, level = 0.0;
    vec2 place;
    bool behind = go.z < 0.0;  // moving against `away`: from the back
    if (leaf.rod) {
        vec2 facing = vec2(go.x, go.z) / max(length(vec2(go.x, go.z)), 1e-12);
        along = -dot(vec2(from.x, from.z), facing) / max(dot(vec2(go.x, go.z), facing), 1e-12);
        vec3 at = from + along * go;
        place = vec2(dot(vec2(at.x, at.z), vec2(facing.y, -facing.x)), at.y);
        behind = false;
    } else {
        if (abs(go.z) < 1e-6 * length(go)) return false;
        along = -from.z / go.z;
        place = from.xy + along * go.xy;
    }
    if (along >= hit.along) return false;
    vec2 size = leaf.half_.xy;
    vec2 margin = leaf.rod ? vec2(0.0) : leaf.half_.z * min(abs(go.xy / go.z), 4.0);
    if (any(greaterThan(abs(place), size + margin))) return false;
    vec4 image = behind ? leaf.back : leaf.front;
    if (image.z == 0.0) return false;
    vec2 flip = vec2(leaf.mirrored ? -1.0 : 1.0, 1.0);
    vec2 texels = image.zw * vec2(textureSize(leaf_color, 0));
    // Texels per sample: a sample's width grows with the distance; the derivative of uv by the sample's place.
    float width = mix(spread.y, spread.x, along) / leaf.scale;
    float lod = clamp(log2(width * max(texels.x / size.x, texels.y / size.y) / 2.0), 0.0, 4.0);
    vec2 inner = 0.5 * exp2(ceil(lod)) / vec2(textureSize(leaf_color, 0));
    vec2 uv;
    for (int i = 0; i <= RELIEF_STEPS; ++i) {
        vec2 unit = clamp(flip * place / size * 0.5 + 0.5, 0.0, 1.0);
        uv = image.xy + clamp(unit * image.zw, min(inner, image.zw / 2.0), max(image.zw - inner, image.zw / 2.0));
        if (leaf.rod || leaf.half_.z == 0.0 || i == RELIEF_STEPS) break;
        float height = (textureLod(leaf_normal, uv, 0.0).b * 2.0 - 1.0) * leaf.half_.z;  // towards the front's viewer
        along = (-height - from.z) / go.z;
        place = from.xy + along * go.xy;
    }
    if (along >= hit.along || along < 0.0 || any(greaterThan(abs(place), size))) return false;
    if (textureLod(leaf_color, uv, lod).a < threshold) return false;
    hit.along = along;
    hit.uv = uv;
    hit.away = start.z + along * way.z;
    hit.behind = behind;
    return true;
}

// Walks a ray through the cells of a billboard and returns the nearest leaf that it meets.
// share: of each list that is looked up, 0..1, from the viewer's end.
Hit look_up(Billboard board, vec3 start, vec3 way, vec2 spread, float share, float threshold) {
    Hit hit = Hit(1e30, -1, vec2(0.0), 0.0, false);
    // Where the ray is in the box.
    vec3 inverse_ = 1.0 / mix(way, vec3(1e-12), lessThan(abs(way), vec3(1e-12)));
    vec3 enter = -start * inverse_;
    vec3 leave = (board.size - start) * inverse_;
    float entry = max(max(min(enter.x, leave.x), min(enter.y, leave.y)), max(min(enter.z, leave.z), 0.0));
    float exit_ = min(min(max(enter.x, leave.x), max(enter.y, leave.y)), max(enter.z, leave.z));
    if (board.size.z == 0.0) entry = exit_ = max(enter.z, 0.0);
    if (entry > exit_) return hit;
    vec2 at = start.xy + entry * way.xy;
    ivec2 cells = ivec2(board.size.xy);
    ivec2 cell = clamp(ivec2(floor(at)), ivec2(0), cells - 1);
    ivec2 step_ = ivec2(sign(way.xy));
    vec2 next = (vec2(cell + max(step_, 0)) - start.xy) * inverse_.xy;
    bool front = way.z > 0.0;
    int width = textureSize(lists_texture, 0).x;
    for (int walked = 0; walked < MOST_CELLS; ++walked) {
        uint texel = texelFetch(hash_texture, board.origin + cell, 0).r;
        int count = int(texel & 1023u);
        int offset = int(texel >> 10);
        int wanted = int(ceil(share * float(count)));
        for (int i = 0; i < wanted; ++i) {
            int number = offset + (front ? i : count - 1 - i);
            int placement = board.first + int(texelFetch(lists_texture, in_rows(number, width), 0).r);
            Leaf leaf = read_leaf(placement, board.size);
            // The list is ordered by centres: once no later leaf can reach before the hit, the walk ends.
            if (hit.placement >= 0) {
                float nearest = front ? leaf.center.z - board.reach : -leaf.center.z - board.reach;
                if (nearest >= (front ? hit.away : -hit.away)) break;
            }
            if (meets_leaf(leaf, start, way, spread, threshold, hit)) hit.placement = placement;
        }
        float turn = min(next.x, next.y);
        if (turn > exit_ || hit.along <= turn) break;
        int axis = next.x < next.y ? 0 : 1;
        cell[axis] += step_[axis];
        next[axis] += abs(inverse_[axis]);
        if (cell[axis] < 0 || cell[axis] >= cells[axis]) break;
    }
    return hit;
}
