// UTF-8 (RFC 3629).
#ifndef RN_COMMON_BASE_UTF8_H
#define RN_COMMON_BASE_UTF8_H

// Bytes of the sequence at `text` (NUL-terminated) and its code point; 0 when it is malformed.
int rn_utf8_decode(const char *text, unsigned *ret_code);
// Puts a question mark in place of each byte that belongs to no sequence.
void rn_utf8_clean(char *text);

#endif
