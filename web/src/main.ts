import './design/tokens.css';
import './design/type.css';
import './design/base.css';
import './design/phone.css';
import { mount } from 'svelte';
import Gate from './components/shell/Gate.svelte';
import { startRouter } from './state/router.svelte';
import { view } from './state/view.svelte';

view.followTheme();
startRouter();
const target = document.getElementById('app');
if (target) mount(Gate, { target });
