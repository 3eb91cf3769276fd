// Lets what is drawn solid fade: as large a part of it is drawn as its opacity says, always the same one, so that from
// frame to frame only what comes or goes differs.
bool faded(uint which, float opacity) {
    uint h = which * 0x9E3779B1u;
    h ^= h >> 15;
    h *= 0x2C1B3C6Du;
    h ^= h >> 12;
    h *= 0x297A2D39u;
    h ^= h >> 15;
    return (float(h >> 9) + 0.5) / 8388608.0 > opacity;
}
