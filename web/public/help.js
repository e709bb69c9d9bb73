// The theme that was chosen in the console.
document.documentElement.dataset.theme = localStorage.getItem('gss-theme') === 'light' ? 'light' : 'dark';
