// Server-sent events over fetch, so that a token can travel in a header.

/**
 * Splits a text stream into events as the HTML standard says (comments, CR, LF and CRLF, several
 * data lines). @param {(event: {id: string, type: string, data: string}) => void} emit
 * @returns {(chunk: string) => void}
 */
export function createParser(emit) {
  let rest = '';
  let id = '';
  let type = '';
  let data = [];
  const line = (text) => {
    if (text === '') {
      if (data.length) emit({id, type: type || 'message', data: data.join('\n')});
      type = '';
      data = [];
      return;
    }
    const colon = text.indexOf(':');
    if (colon === 0) return;
    const name = colon < 0 ? text : text.slice(0, colon);
    const value = colon < 0 ? '' : text.slice(colon + 1).replace(/^ /, '');
    if (name === 'id')
      id = value;
    else if (name === 'event')
      type = value;
    else if (name === 'data')
      data.push(value);
  };
  return (chunk) => {
    rest += chunk;
    for (;;) {
      const end = rest.search(/[\r\n]/);
      if (end < 0 || rest[end] === '\r' && end + 1 === rest.length) return;
      const size = rest[end] === '\r' && rest[end + 1] === '\n' ? 2 : 1;
      line(rest.slice(0, end));
      rest = rest.slice(end + size);
    }
  };
}

const SILENCE_MS = 45_000;  // three heartbeats

/**
 * Reads one stream to its end. Resolves when the server ends it; throws what `open` throws, and
 * an Error when the line stays silent for longer than three heartbeats.
 * @param {(headers: object, signal: AbortSignal) => Promise<Response>} open
 * @param {{lastId?: string, signal: AbortSignal, onOpen?: () => void,
 *          onEvent: (type: string, data: any, id: string) => void}} options
 */
export async function readEvents(open, {lastId, signal, onOpen, onEvent}) {
  const own = new AbortController();
  const stop = () => own.abort();
  signal.addEventListener('abort', stop, {once: true});
  let timer = 0;
  const alive = () => {
    clearTimeout(timer);
    timer = setTimeout(stop, SILENCE_MS);
  };
  try {
    alive();
    const headers = {Accept: 'text/event-stream'};
    if (lastId) headers['Last-Event-ID'] = lastId;
    const response = await open(headers, own.signal);
    onOpen?.();
    const parse = createParser(({id, type, data}) => onEvent(type, JSON.parse(data), id));
    const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
    for (;;) {
      const {done, value} = await reader.read();
      if (done) return;
      alive();
      parse(value);
    }
  } finally {
    clearTimeout(timer);
    signal.removeEventListener('abort', stop);
    own.abort();
  }
}
