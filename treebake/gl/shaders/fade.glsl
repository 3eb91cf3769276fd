// Lets what is drawn solid fade: as large a part of its pixels is drawn as its opacity says, always the same ones.
bool faded_out(float opacity) {
    uint h = uint(gl_FragCoord.x) * 0x9E3779B1u ^ uint(gl_FragCoord.y) * 0x85EBCA77u;
    h ^= h >> 15;
    h *= 0x2C1B3C6Du;
    h ^= h >> 12;
    h *= 0x297A2D39u;
    h ^= h >> 15;
    return (float(h >> 9) + 0.5) / 8388608.0 > opacity;
}
