// Starts the page. Where a part of it was lost on its way, the page is loaded anew: a module that
// failed once is not asked for again.
(() => {
  const TRIES = 'ripnerf-tries';
  const MOST = 20;
  if (window.ripnerfStarted) return;  // the page names this file twice, as it may be lost too
  window.ripnerfStarted = true;
  const again = () => {
    const tries = Number(sessionStorage.getItem(TRIES)) + 1;
    if (tries > MOST) return;
    sessionStorage.setItem(TRIES, String(tries));
    setTimeout(() => location.reload(), 200 * tries);
  };
  const whole =
      () => [...document.querySelectorAll('link[rel=stylesheet]')].every((one) => one.sheet);
import('./main.js')
      .then(() => (whole() ? sessionStorage.removeItem(TRIES) : again()), (error) => {
        console.warn(error); again();
      });
})();
