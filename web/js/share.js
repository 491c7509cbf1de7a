// Links for people without a token of their own: a token for one thing, in the address's fragment.
import {api} from './api.js';
import {copyWords} from './ui.js';

const DAYS = 30;

/** A name that no other link has. */
const nameFor = (word) => `link-${word.slice(0, 40)}-${Date.now().toString(36)}`;

/**
 * Makes a link and copies it, or shows it where it cannot be copied.
 * @param {{scene: string}|{job: string}} what @param {string} hash where it leads, "#/scene/…"
 * @param {string} word names it in the list of tokens
 */
export async function copyLink(what, hash, word) {
  const made = await api.makeToken({name: nameFor(word), expires_s: DAYS * 86400, ...what});
  const address = new URL(location.href);
  address.hash = `t=${made.token}${hash.replace(/^#/, '')}`;
  const more = `Who has it sees this and nothing else, for ${DAYS} days; "ripnerf token revoke ${
      made.name}" ends it.`;
  await copyWords(address.href, {what: 'A link to share', copied: `A link is copied. ${more}`, more});
}
