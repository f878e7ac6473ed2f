// A table that its column cannot hold shows each row as a block of labelled values.
const LONG = 18;

function fit(tables) {
  tables.forEach((table) => table.classList.remove('stacked'));
  const wide = tables.map((table) => table.parentElement)
    .filter((box) => box.scrollWidth > box.clientWidth);
  wide.forEach((box) => box.querySelector('table').classList.add('stacked'));
}

addEventListener('DOMContentLoaded', () => {
  const tables = [...document.querySelectorAll('table.docutils')].filter((table) => table.tHead);
  for (const table of tables) {
    const labels = [...table.tHead.rows[0].cells].map((cell) => cell.textContent.trim());
    for (const row of table.tBodies[0].rows) {
      [...row.cells].forEach((cell, column) => {
        const text = cell.textContent.trim();
        cell.dataset.label = column ? labels[column] : '';
        cell.classList.toggle('long', text.length > LONG);
        cell.classList.toggle('empty', column > 0 && ['', '-'].includes(text));
      });
    }
  }
  fit(tables);
  addEventListener('resize', () => fit(tables));
});
