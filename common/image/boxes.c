#include "common/image/boxes.h"

bool rn_span_take(struct rn_span *from, int size, uint64_t *ret_value) {
    uint64_t value = 0;
    if (from->end - from->at < size) return false;
    for (int i = 0; i < size; i++)
        value = value << 8 | *from->at++;
    *ret_value = value;
    return true;
}

bool rn_box_take_header(struct rn_span *from, uint64_t *ret_size, uint32_t *ret_type) {
    const uint8_t *begin = from->at;
    uint64_t size, type, name;
    if (!rn_span_take(from, 4, &size) || !rn_span_take(from, 4, &type)) return false;
    if (size == 1 && !rn_span_take(from, 8, &size)) return false;
    if (type == RN_BOX('u', 'u', 'i', 'd') &&
        (!rn_span_take(from, 8, &name) || !rn_span_take(from, 8, &name)))
        return false;
    uint64_t header = (uint64_t)(from->at - begin);
    *ret_size = size == 0 ? (uint64_t)(from->end - from->at) : size < header ? 0 : size - header;
    *ret_type = (uint32_t)type;
    return size == 0 || size >= header;
}

bool rn_box_take(struct rn_span *from, uint32_t *ret_type, struct rn_span *ret_body) {
    uint64_t size;
    if (!rn_box_take_header(from, &size, ret_type) || size > (uint64_t)(from->end - from->at))
        return false;
    *ret_body = (struct rn_span){from->at, from->at + size};
    from->at += size;
    return true;
}
