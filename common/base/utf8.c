#include "common/base/utf8.h"

#include <string.h>

int rn_utf8_decode(const char *text, unsigned *ret_code) {
    const unsigned char *s = (const unsigned char *)text;
    static const unsigned smallest[] = {0, 0, 0x80, 0x800, 0x10000};
    int length = s[0] < 0x80       ? 1
                 : s[0] >> 5 == 6  ? 2
                 : s[0] >> 4 == 14 ? 3
                 : s[0] >> 3 == 30 ? 4
                                   : 0;
    if (length == 0) return 0;
    unsigned code = length == 1 ? s[0] : s[0] & (0x7fu >> length);
    for (int i = 1; i < length; i++) {
        if (s[i] >> 6 != 2) return 0; // also stops at the NUL
        code = code << 6 | (s[i] & 0x3fu);
    }
    if (code < smallest[length] || code > 0x10ffff || (code >= 0xd800 && code < 0xe000)) return 0;
    *ret_code = code;
    return length;
}

void rn_utf8_clean(char *text) {
    for (char *at = text; *at != '\0';) {
        unsigned code;
        int length = rn_utf8_decode(at, &code);
        if (length == 0) *at = '?';
        at += length == 0 ? 1 : length;
    }
}
